"""Where faults and tests reach in: connections, requests, and every frame that goes out."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.transports import Transport

#: Writes something to a connection where an ordinary frame would be sent.
Write = Callable[[Transport], Awaitable[None]]
#: An encoded frame, or what writes one that could not be sent in the ordinary way.
Encoded = str | bytes | Write
#: Makes what goes out of an encoded frame.
Damage = Callable[[Codec, str | bytes], Encoded]
#: Sends a frame that was held back.
Release = Callable[[], None]


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
        hold: Is given for which client it is, and what sends it, instead of its being sent; the
            delay begins after that.
        damage: What is done to the frame once it is encoded.
    """

    type: str
    body: Message | None
    sn: int = 0
    ok: bool | None = None
    msg: str = ""
    request: str = ""
    delay: float = 0.0
    hold: Callable[[object, Release], None] | None = None
    damage: Damage | None = None

    @property
    def is_answer(self) -> bool:
        """Whether it is an answer; else it is a push."""
        return self.ok is not None


#: Gives what shall go out instead of a frame: the same, another, several or none.
Interceptor = Callable[[Outgoing], Iterable[Outgoing]]
#: Why a request of this type is refused, None if it is not.
Objector = Callable[[str], "str | None"]
#: Whether a new connection is served.
Screen = Callable[[], bool]
#: Takes a hook away again.
Remove = Callable[[], None]

_T = TypeVar("_T")


class Hooks:
    """What is to go otherwise than usual."""

    def __init__(self) -> None:
        self._screens: list[Screen] = []
        self._objectors: list[Objector] = []
        self._faults: list[Interceptor] = []
        self._interceptors: list[Interceptor] = []

    def screen(self, screen: Screen) -> Remove:
        """Ask `screen` about each new connection."""
        return _add(self._screens, screen)

    def object(self, objector: Objector) -> Remove:
        """Ask `objector` about each request before it is done."""
        return _add(self._objectors, objector)

    def tamper(self, interceptor: Interceptor) -> Remove:
        """Let all frames through `interceptor`, before those of `intercept`."""
        return _add(self._faults, interceptor)

    def intercept(self, interceptor: Interceptor) -> Remove:
        """Let all frames through `interceptor`; the returned function takes it away again."""
        return _add(self._interceptors, interceptor)

    def admits(self) -> bool:
        """Whether a new connection is served."""
        return all(screen() for screen in list(self._screens))

    def refusal(self, type_name: str) -> str | None:
        """Why a request of a type is refused, by the last who objects; None if nobody does."""
        reasons = (objector(type_name) for objector in reversed(list(self._objectors)))
        return next((reason for reason in reasons if reason is not None), None)

    def outgoing(self, frame: Outgoing) -> list[Outgoing]:
        """What goes out in place of `frame`."""
        frames = [frame]
        for interceptor in [*self._faults, *self._interceptors]:
            frames = [out for each in frames for out in interceptor(each)]
        return frames


def _add(hooks: list[_T], hook: _T) -> Remove:
    hooks.append(hook)

    def remove() -> None:
        for place, each in enumerate(hooks):
            if each is hook:
                del hooks[place]
                return

    return remove
