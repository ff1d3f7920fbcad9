"""Frames: the envelope, the body, which is decoded on demand, and the answer to a request."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn, Protocol, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.protos import full_name, message_types
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.sentences import REFUSED

M = TypeVar("M", bound=Message)
T = TypeVar("T")
E = TypeVar("E", bound="FieldError")

SUBSCRIPTION_TYPE = "woosh.Subscription"
"""`type` of a subscribe frame, which is not the full name of its body's message."""

SUBSCRIPTION_TYPES = (SUBSCRIPTION_TYPE, full_name(Subscription))
"""Every `type` by which clients subscribe: some use the full name."""

_LONGEST_TYPE = 200
"""Longest type name that is kept, in characters. Real ones are less than half as long."""


def clip_type_name(name: str) -> str:
    """Return the type name that a frame gives, cut to a length that fits errors and logs."""
    return name[:_LONGEST_TYPE]


class FrameError(Exception):
    """A frame that cannot be read.

    Attributes:
        kind: name of the kind of defect, e.g. `json`, by which defects are counted and logged once.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(detail)
        self.kind = kind


class FieldError(ValueError):
    """A value that does not fit its field.

    Attributes:
        path: path of the field inside the message, e.g. `pose.x` or `steps[2].mode`.
        reason: the text without the path.
    """

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(f"{path}: {reason}" if path else reason)
        self.path = path
        self.reason = reason

    def below(self: E, outer: str) -> E:
        """Return the same error with the field or the list index `outer` put before its path."""
        separator = "" if not self.path or self.path.startswith("[") else "."
        return type(self)(f"{outer}{separator}{self.path}", self.reason)


@dataclass(slots=True)
class Envelope:
    """One frame.

    Attributes:
        type: protobuf full name of the body's message.
        body: the body, not decoded yet (see `Codec.body`); None if only `message` has it.
        ok: True if the chassis accepted the request, False if it refused it; False without an `sn`
            is an error that belongs to no request. None if the frame does not tell.
        msg: text of the chassis, in the language of the chassis.
        sn: serial number of the request and its answer, 1..2^31-1; 0 if there is none.
        timestamp: Unix time in ms; None if the frame has none, or an invalid one.
        defect: why the timestamp is invalid; empty if it is valid, or if there is none.
        is_large: True if the body is decoded and converted in the thread for large messages; see
            `tasks.offload`.
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
        """Return a frame as it goes on the wire; the arguments are as in `Envelope`.

        Args:
            body: the message; None for an empty body.
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


class Body:
    """The body of one frame, decoded on demand.

    Args:
        on_bad: called once if the body does not fit its type; not for an unknown type.

    Attributes:
        type: protobuf full name of the body's message, as the frame gives it.
        is_large: True if the body is converted in the thread for large messages; `tasks.offload`.
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
        """Return the body, converted by one of two functions.

        Args:
            from_json: converts the value of a JSON body that is not decoded yet, without a protobuf
                message in between; raises FieldError.
            from_message: converts the protobuf message of any other body.

        Raises:
            FrameError: the type is unknown, or the body does not fit it.
        """
        if self._message is not None or isinstance(self._value, bytes):  # bytes: protobuf
            return from_message(self.message())
        try:
            return from_json({} if self._value is None else self._value)
        except FieldError as error:
            self._fail(FrameError("body", f"{self.type}: {error}"))

    def as_type(self, name: str) -> Body:
        """Return the same content as the body of another type.

        For answers of a chassis that labels them with the type of the request.

        Args:
            name: protobuf full name of that type.
        """
        envelope = Envelope(name, self._value, is_large=self.is_large)
        return Body(self._codec, envelope, self._on_bad)

    def _fail(self, error: FrameError) -> NoReturn:
        """Raise an error; keep the first one, and report it to `on_bad`."""
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
        is_outdated: True if a newer push of the same type was delivered before this large answer
            was decoded; for RobotInfo, a newer push of any type.
    """

    ok: bool
    msg: str
    raw: Body
    is_outdated: bool = False

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
    def reason(self) -> str:
        """Why the chassis refused the request; if it accepted the request, the `defect`."""
        return self.defect if self.ok else self.msg or REFUSED()

    @property
    def defect(self) -> str:
        """The reason why `body` is None; empty if there is a body."""
        try:
            self.raw.message()
        except FrameError as error:
            return f"the answer cannot be read: {error}"
        return ""
