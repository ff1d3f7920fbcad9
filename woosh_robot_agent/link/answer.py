"""The answer to a request, and the body of a frame, which is decoded on demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.codecs.json_codec import FieldError
from woosh_robot_agent.link.protos import message_types

T = TypeVar("T")


class Body:
    """The body of one frame, decoded on demand.

    Args:
        codec: decodes the body.
        envelope: the frame.
        on_bad: called once if the body cannot be read.

    Attributes:
        type: protobuf full name of the body's message, as the frame gives it.
        is_large: True if handling the body may take long; see `aside`.
    """

    __slots__ = ("_codec", "_error", "_message", "_on_bad", "_value", "is_large", "type")

    def __init__(
        self, codec: Codec, envelope: Envelope, on_bad: Callable[[FrameError], None]
    ) -> None:
        self.type = envelope.type
        self._value = envelope.body
        self._codec = codec
        self._on_bad = on_bad
        self.is_large = envelope.is_large
        self._message = envelope.message
        self._error: FrameError | None = None

    def message(self) -> Any:
        """Return the body as a protobuf message, which is decoded by the first call.

        Raises:
            FrameError: the type is unknown, or the body does not fit it.
        """
        if self._message is None:
            if self._error is not None:
                raise self._error
            cls = message_types().get(self.type)
            if cls is None:
                raise FrameError("type", f"it has the unknown type {self.type!r}")
            try:
                self._message = self._codec.body(Envelope(self.type, self._value), cls)
            except FrameError as error:
                self._fail(error)
        return self._message

    def read(self, from_json: Callable[[object], T], from_message: Callable[[Any], T]) -> T:
        """Return the body as converted by one of two functions.

        A JSON body is converted directly, without a protobuf message in between.

        Args:
            from_json: converts the JSON value of a JSON body; raises FieldError.
            from_message: converts the protobuf message of any other body.

        Raises:
            FrameError: the type is unknown, or the body does not fit it.
        """
        if self._message is not None or isinstance(self._value, bytes):
            return from_message(self.message())
        try:
            return from_json({} if self._value is None else self._value)
        except FieldError as error:
            self._fail(FrameError("body", f"{self.type}: {error}"))

    def as_type(self, name: str) -> Body:
        """Return the same content as the body of another type.

        Args:
            name: protobuf full name of that type.
        """
        envelope = Envelope(name, self._value, is_large=self.is_large)
        return Body(self._codec, envelope, self._on_bad)

    def _fail(self, error: FrameError) -> NoReturn:
        if self._error is None:
            self._error = error
            self._on_bad(error)
        raise error from None


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
