"""Errors of requests to the chassis. Each text names the cause and the remedy."""

from __future__ import annotations


class LinkError(Exception):
    """Base class of all errors of the link."""


class NotConnectedError(LinkError):
    """There is no link to the chassis; nothing was sent."""


class ConnectionLostError(LinkError):
    """The link went down before the answer arrived; the request may have taken effect."""


class HandshakeError(LinkError):
    """The other end accepted the connection but does not behave like a chassis."""


class RequestTimeoutError(LinkError):
    """The chassis did not answer in time; the request may have taken effect."""


class TooManyRequestsError(LinkError):
    """The maximum number of requests is in flight already; nothing was sent."""


class NotPermittedError(LinkError):
    """The client may not send the request; nothing was sent. See `ChassisClient.permit_only`."""


class SupersededError(LinkError):
    """The request was withdrawn or waited too long to be sent; nothing was sent."""
