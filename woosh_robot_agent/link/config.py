"""The configuration of the link, and the errors of the link, e.g. NotConnectedError."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from ipaddress import IPv6Address
from typing import Literal


class LinkError(Exception):
    """Base class of all errors of the link."""


class NotConnectedError(LinkError):
    """There is no link to the chassis; nothing was sent."""


class ConnectionLostError(LinkError):
    """The link went down before the answer arrived; the request may have taken effect."""


class HandshakeError(LinkError):
    """The other end accepted the connection but does not behave like a chassis."""


class OtherRobotError(LinkError):
    """The robot at the address is not the one that answered first; nothing is sent."""


class RequestTimeoutError(LinkError):
    """The chassis did not answer in time; the request may have taken effect."""


class TooManyRequestsError(LinkError):
    """The maximum number of requests is in flight already; nothing was sent."""


class NotPermittedError(LinkError):
    """`ChassisClient.permit_only` excludes the request; nothing was sent."""


class SupersededError(LinkError):
    """The request was withdrawn or waited too long to be sent; nothing was sent."""


DEFAULT_IP = "169.254.128.2"
"""Factory default address of a chassis."""
DEFAULT_PORTS = {"websocket": 5480, "tcp": 5481}
"""Default port of each transport."""
ENCODINGS = ("json", "protobuf")
"""Encodings of a frame."""
MIB = 1024 * 1024
"""One mebibyte, in bytes."""


_CHANGEABLE = ("request_timeout", "connect_timeout", "handshake_timeout")
"""Fields of a configuration that can change without a new connection."""


@dataclass(frozen=True)
class LinkConfig:
    """Address, encoding, timeouts and limits of one link. All times are in seconds.

    Attributes:
        ip: address or host name of the chassis.
        port: port of the chassis; 0 takes the transport's default, 5480 for websocket and 5481
            for tcp.
        transport: `websocket` or `tcp`.
        encoding: `json` or `protobuf`; ignored by tcp, which always carries protobuf.
        request_timeout: maximum wait for an answer.
        connect_timeout: maximum duration of connecting, including the WebSocket handshake.
        handshake_timeout: maximum wait for the first RobotInfo, which makes the link ready.
        close_timeout: maximum duration of an orderly close.
        liveness_timeout: time without any frame, even in answer to pings, after which the link
            counts as lost.
        backoff_min: first pause between attempts to connect; it doubles with each attempt.
        backoff_max: longest pause between attempts to connect.
        stable_after: time that a link must stay ready before the pauses start again at
            `backoff_min`.
        max_frame_size: largest frame that is read, in bytes.
        max_in_flight: maximum number of requests in flight.
        push_queue: maximum number of pushes that are queued for slow consumers, for each of these
            types: status codes, task reports, feedbacks. A client keeps the value it began with.
        robot_id: id of the robot behind a gateway, for the link's own requests; 0 sends no id.

    Raises:
        ValueError: a value is not valid; the text names the value and the reason.
    """

    ip: str = DEFAULT_IP
    port: int = 0
    transport: Literal["websocket", "tcp"] = "websocket"
    encoding: Literal["json", "protobuf"] = "json"
    request_timeout: float = 10.0
    connect_timeout: float = 5.0
    handshake_timeout: float = 5.0
    close_timeout: float = 1.0
    liveness_timeout: float = 10.0
    backoff_min: float = 0.5
    backoff_max: float = 15.0
    stable_after: float = 5.0
    max_frame_size: int = 64 * MIB
    max_in_flight: int = 64
    push_queue: int = 1000
    robot_id: int = 0

    def __post_init__(self) -> None:
        if not _is_host(self.ip):
            raise ValueError(
                f"ip {self.ip!r} is neither an address nor a host name; a port goes into `port`"
            )
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port {self.port} is not in 0..65535")
        if not 0 <= self.robot_id < 2**32:
            raise ValueError(f"robot_id {self.robot_id} is not in 0..{2**32 - 1}")
        if self.transport not in DEFAULT_PORTS:
            raise ValueError(f"transport {self.transport!r} is not one of {list(DEFAULT_PORTS)}")
        if self.encoding not in ENCODINGS:
            raise ValueError(f"encoding {self.encoding!r} is not one of {list(ENCODINGS)}")
        for name in (
            "request_timeout",
            "connect_timeout",
            "handshake_timeout",
            "close_timeout",
            "liveness_timeout",
            "backoff_min",
            "max_frame_size",
            "max_in_flight",
            "push_queue",
        ):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(
                    f"{name} must be a number above 0, and finite, not {getattr(self, name)}"
                )
        if not 0 <= self.stable_after < math.inf:
            raise ValueError(
                f"stable_after must be 0 or above, and finite, not {self.stable_after}"
            )
        if not self.backoff_min <= self.backoff_max < math.inf:
            raise ValueError(
                f"backoff_max must be finite and at least backoff_min ({self.backoff_min}), "
                f"not {self.backoff_max}"
            )

    def keeps_connection(self, previous: LinkConfig) -> bool:
        """Return True if a connection that was opened with `previous` can stay."""
        kept = {name: getattr(self, name) for name in _CHANGEABLE}
        return self == replace(previous, **kept)

    @property
    def effective_port(self) -> int:
        """The configured port, or the transport's default if that is 0."""
        return self.port or DEFAULT_PORTS[self.transport]

    @property
    def address(self) -> str:
        """Address of the chassis as a URL, e.g. `ws://169.254.128.2:5480`."""
        scheme = "ws" if self.transport == "websocket" else "tcp"
        return f"{scheme}://{url_host(self.ip)}:{self.effective_port}"


def url_host(host: str) -> str:
    """Return an address or host name as a URL has it: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def _is_host(text: str) -> bool:
    """Return True for an IP address, or for a text that may be a host name."""
    if ":" not in text:
        return bool(re.fullmatch(r"[\w.-]+", text)) and all(
            0 < len(label) < 64 for label in text.removesuffix(".").split(".")
        )
    try:
        IPv6Address(text)
    except ValueError:
        return False
    return True
