"""Envelope of a frame, independent of its encoding, and the interface of a codec."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

from google.protobuf.message import Message

M = TypeVar("M", bound=Message)

SUBSCRIPTION_TYPE = "woosh.Subscription"
"""`type` of a subscribe frame, which is not the full name of its body's message."""

_LONGEST_TYPE = 200
"""Longest type name that is kept, in characters. Real ones are less than half as long."""


def clip_type_name(name: str) -> str:
    """Return the type name that a frame gives, cut to a length that fits errors and logs."""
    return name[:_LONGEST_TYPE]


class FrameError(Exception):
    """A frame that cannot be read.

    Attributes:
        kind: short constant name of the defect, used to count it and to log it once.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(detail)
        self.kind = kind


@dataclass(slots=True)
class Envelope:
    """One frame.

    Attributes:
        type: protobuf full name of the body's message.
        body: the body, not decoded yet; pass it to `Codec.body`.
        ok: True if the chassis accepted the request, False if it refused; None if the frame is
            not an answer.
        msg: text of the chassis, in the language of the chassis.
        sn: serial number of the request and its answer, 1..2^31-1; 0 if there is none.
        timestamp: Unix time in ms; None if the sender left it out, or if it is no time.
        defect: why the timestamp cannot be used; empty if it can, or is left out.
        is_large: True if handling the body may take long; see `aside`.
        message: the decoded body of a large frame; None if it is not decoded yet.
    """

    type: str
    body: object
    ok: bool | None = None
    msg: str = ""
    sn: int = 0
    timestamp: int | None = None
    defect: str = ""
    is_large: bool = False
    message: Message | None = None


class Codec(Protocol):
    """One encoding of the envelope."""

    def encode(
        self,
        type_name: str,
        body: Message | None,
        *,
        sn: int = 0,
        ok: bool | None = None,
        msg: str = "",
        timestamp: int | None = None,
    ) -> str | bytes:
        """Return a frame as it goes on the wire.

        Args:
            type_name: protobuf full name of the body's message.
            body: None for an empty body.
            sn: serial number of a request or an answer; 0 for a push.
            ok: True or False for an answer; None for a request or a push.
            msg: text of an answer.
            timestamp: Unix time in ms; None to leave it out.
        """

    def decode(self, data: str | bytes) -> Envelope:
        """Return the envelope of a frame, with the body not decoded yet.

        Raises:
            FrameError: the data is not a frame of this encoding.
        """

    def body(self, envelope: Envelope, cls: type[M]) -> M:
        """Return the body of a decoded frame as a message of `cls`.

        Raises:
            FrameError: the body does not fit `cls`.
        """
