"""Hooks by which faults and tests intercept connections, requests and outgoing frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.server.outbox import Encoded

Damage = Callable[[Codec, str | bytes], Encoded]
"""Returns the damaged form of an encoded frame."""

Release = Callable[[], None]
"""Sends a frame that was held back."""


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A frame before it is encoded.

    Attributes:
        type: Type of the body in the frame's envelope.
        body: Body, None for an empty one.
        sn: Serial number of the request that it answers; 0 for a push.
        ok: True if the request was executed, False if it was refused; None for a push.
        msg: Text of an answer.
        request: Type of the request that it answers; empty for a push.
        delay: Real time to delay the frame, in seconds.
        hold: Called with the client and a send function instead of sending the frame. The delay
            starts when the send function is called.
        damage: Applied to the encoded frame.
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
        """True for an answer, False for a push."""
        return self.ok is not None


Interceptor = Callable[[Outgoing], Iterable[Outgoing]]
"""Returns the frames to send instead of a frame: the same one, others, or none."""

Refuse = Callable[[str], "str | None"]
"""Returns the reason to refuse a request of the given type, or None."""

Admit = Callable[[], bool]
"""Returns False to drop a new connection."""

Remove = Callable[[], None]
"""Removes a hook."""

_T = TypeVar("_T")


class Hooks:
    """The registered hooks. Each method that adds one returns a function that removes it."""

    def __init__(self) -> None:
        self._admissions: list[Admit] = []
        self._refusals: list[Refuse] = []
        self._faults: list[Interceptor] = []
        self._interceptors: list[Interceptor] = []

    def add_admission(self, admit: Admit) -> Remove:
        """Call `admit` for each new connection."""
        return _add(self._admissions, admit)

    def add_refusal(self, refuse: Refuse) -> Remove:
        """Call `refuse` for each request before it is executed."""
        return _add(self._refusals, refuse)

    def add_fault(self, interceptor: Interceptor) -> Remove:
        """Pass all outgoing frames through `interceptor`, before those of `intercept`."""
        return _add(self._faults, interceptor)

    def intercept(self, interceptor: Interceptor) -> Remove:
        """Pass all outgoing frames through `interceptor`."""
        return _add(self._interceptors, interceptor)

    def admits(self) -> bool:
        """Return False if a new connection must be dropped."""
        return all(admit() for admit in list(self._admissions))

    def refusal(self, type_name: str) -> str | None:
        """Return the reason to refuse a request of a type, or None. The latest hook wins."""
        reasons = (refuse(type_name) for refuse in reversed(list(self._refusals)))
        return next((reason for reason in reasons if reason is not None), None)

    def outgoing(self, frame: Outgoing) -> list[Outgoing]:
        """Return the frames to send in place of `frame`."""
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
