"""Why a request to the chassis failed. Each text names the cause and the remedy."""

from __future__ import annotations


class LinkError(Exception):
    """Base of all errors of the link."""


class NotConnectedError(LinkError):
    """There is no link to the chassis; nothing was sent."""


class ConnectionLostError(LinkError):
    """The link went down; whether a request under way took effect is not known."""


class HandshakeError(LinkError):
    """Something answered at the address, but not as a chassis does."""


class RequestTimeoutError(LinkError):
    """The chassis did not answer in time; whether the request took effect is not known."""


class TooManyRequestsError(LinkError):
    """As many requests as allowed wait for their answers already; nothing was sent."""


class SupersededError(LinkError):
    """The request was withdrawn or waited too long to be sent; nothing was sent."""
