"""The body of a frame: kept as it came, and read when somebody wants it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.codecs.json_mapping import FieldError
from woosh_robot_agent.protos import message_types

T = TypeVar("T")


class Body:
    """The body of one frame.

    Args:
        codec: reads it.
        envelope: the frame.
        tell_bad: is told, once, that it cannot be read.

    Attributes:
        type: protobuf full name of its message, as the frame gives it.
    """

    __slots__ = ("_codec", "_error", "_message", "_tell_bad", "_value", "type")

    def __init__(
        self, codec: Codec, envelope: Envelope, tell_bad: Callable[[FrameError], None]
    ) -> None:
        self.type = envelope.type
        self._value = envelope.body
        self._codec = codec
        self._tell_bad = tell_bad
        self._message: Message | None = None
        self._error: FrameError | None = None

    def message(self) -> Any:
        """The message, made the first time it is asked for.

        Raises:
            FrameError: its type is unknown, or it is no such message.
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
        """What one of two functions makes of it: JSON need not become a message before.

        Args:
            from_json: takes the JSON value, if it came as such; raises FieldError.
            from_message: takes the message else.

        Raises:
            FrameError: see `message`.
        """
        if isinstance(self._value, bytes):
            return from_message(self.message())
        try:
            return from_json({} if self._value is None else self._value)
        except FieldError as error:
            self._fail(FrameError("body", f"{self.type}: {error}"))

    def _fail(self, error: FrameError) -> NoReturn:
        if self._error is None:
            self._error = error
            self._tell_bad(error)
        raise error from None
