"""Where tests reach in: every frame that goes out passes through interceptors."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from google.protobuf.message import Message


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A frame before it is encoded.

    Attributes:
        type: What the frame says its body is.
        body: None for an empty one.
        sn: The number of the request it answers; 0 for a push.
        ok: Whether the request was done; None for a push.
        msg: The text of an answer.
        request: The type of the request it answers; empty for a push.
        delay: Seconds of real time to hold it back.
    """

    type: str
    body: Message | None
    sn: int = 0
    ok: bool | None = None
    msg: str = ""
    request: str = ""
    delay: float = 0.0


#: Gives what shall go out instead of a frame: the same, another, several or none.
Interceptor = Callable[[Outgoing], Iterable[Outgoing]]


class Hooks:
    """What is to go otherwise than usual."""

    def __init__(self) -> None:
        self._refusals: dict[str, str] = {}
        self._interceptors: list[Interceptor] = []
        self._answers: dict[tuple[str, str], Callable[[Outgoing], Iterable[Outgoing]]] = {}

    def refuse(self, type_name: str, text: str) -> None:
        """Refuse every request of a type with `text`, without doing it."""
        self._refusals[type_name] = text

    def refusal(self, type_name: str) -> str | None:
        """Why requests of a type are refused, None if they are not."""
        return self._refusals.get(type_name)

    def delay(self, type_name: str, seconds: float) -> None:
        """Hold back every answer to a type for `seconds` of real time."""
        self._on_answer("delay", type_name, lambda out: [dataclasses.replace(out, delay=seconds)])

    def mute(self, type_name: str) -> None:
        """Do what requests of a type ask but never answer them."""
        self._on_answer("mute", type_name, lambda out: [])

    def answer_as(self, type_name: str, other: str) -> None:
        """Say in every answer to a type that its body is of the type `other`."""
        self._on_answer("type", type_name, lambda out: [dataclasses.replace(out, type=other)])

    def accept(self, type_name: str) -> None:
        """Treat requests of a type as usual again."""
        self._refusals.pop(type_name, None)
        for key in [key for key in self._answers if key[1] == type_name]:
            del self._answers[key]

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Let all frames through `interceptor`; the returned function takes it away again."""
        self._interceptors.append(interceptor)
        return lambda: self._interceptors.remove(interceptor)

    def outgoing(self, frame: Outgoing) -> list[Outgoing]:
        """What goes out in place of `frame`."""
        frames = [frame]
        for interceptor in [self._answered, *self._interceptors]:
            frames = [out for each in frames for out in interceptor(each)]
        return frames

    def _on_answer(self, what: str, type_name: str, interceptor: Interceptor) -> None:
        self._answers[what, type_name] = interceptor

    def _answered(self, frame: Outgoing) -> list[Outgoing]:
        frames = [frame]
        for (_, type_name), interceptor in self._answers.items():
            if frame.request == type_name:
                frames = [out for each in frames for out in interceptor(each)]
        return frames
