"""The answer to a request."""

from __future__ import annotations

from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.link.body import Body
from woosh_robot_agent.link.codecs.frames import FrameError


@dataclass(frozen=True)
class Answer:
    """The chassis's answer to a request.

    Attributes:
        ok: True if the chassis accepted the request.
        msg: text from the chassis, unchanged.
        raw: the body, not decoded yet.
    """

    ok: bool
    msg: str
    raw: Body

    @property
    def type(self) -> str:
        """Protobuf full name of the body's message, as the frame gives it."""
        return self.raw.type

    @property
    def body(self) -> Message | None:
        """The body's message; None if its type is unknown or it cannot be read."""
        try:
            return self.raw.message()  # type: ignore[no-any-return]
        except FrameError:
            return None

    @property
    def defect(self) -> str:
        """The reason why `body` is None; empty if it is not."""
        try:
            self.raw.message()
        except FrameError as error:
            return f"the answer cannot be read: {error}"
        return ""
