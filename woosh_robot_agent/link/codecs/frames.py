"""What a frame says, whatever its encoding: the envelope around one protobuf message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

from google.protobuf.message import Message

M = TypeVar("M", bound=Message)

SUBSCRIPTION_TYPE = "woosh.Subscription"
"""`type` of a subscribe frame; on the wire it is not the body's protobuf full name."""


_LONGEST_TYPE = 200
"""Characters of a type's name; those of the chassis have less than half as many."""


def usable_type(name: str) -> str:
    """The type that a frame gives, cut where no name is as long: it gets into errors and logs."""
    return name[:_LONGEST_TYPE]


class FrameError(Exception):
    """A frame that cannot be read.

    Attributes:
        kind: a short constant name of the defect, to count and to log once by.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(detail)
        self.kind = kind


@dataclass(slots=True)
class Envelope:
    """One frame.

    Attributes:
        type: protobuf full name of the body's message.
        body: the body as the codec left it; `Codec.body` makes a message of it.
        ok: whether the chassis accepted the request; None where the frame is not an answer.
        msg: the chassis's text, in the chassis's own language.
        sn: serial number of the request and its answer, 1..2^31-1; 0 where there is none.
        timestamp: Unix time in ms, None where the sender left it out.
    """

    type: str
    body: object
    ok: bool | None = None
    msg: str = ""
    sn: int = 0
    timestamp: int | None = None


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
        """The frame as it goes on the wire; `ok` None makes it a request or a push."""

    def decode(self, data: str | bytes) -> Envelope:
        """Read the envelope and leave the body for later.

        Raises:
            FrameError: the data is no frame of this encoding.
        """

    def body(self, envelope: Envelope, cls: type[M]) -> M:
        """Read the body of a decoded frame as a message of `cls`.

        Raises:
            FrameError: the body is not such a message.
        """
