"""The observers of a robot with a scripted chassis behind a real socket."""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncIterator
from types import ModuleType
from typing import Any

import pytest

from tests.link.link_peer import Frame, Peer, Wire, eventually
from woosh_robot_agent.link import Answer
from woosh_robot_agent.motion import MotionGate, Sender
from woosh_robot_agent.robot import refusals, standstill, who_drives
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.watch import Watch

READY = {
    "mode": {"ctrl": 1, "work": 2},
    "state": 2,
    "deviceState": {"software": 1},
    "poseSpeed": {"pose": {"x": 1.0, "y": 2.0, "theta": 3.0}, "mapId": 3},
}


class StoppedClock:
    """Takes the place of the module `time` in another module; the test sets the monotonic time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> None:
        self.now = time.monotonic()
        monkeypatch.setattr(module, "time", self)

    def monotonic(self) -> float:
        return self.now


class Rig:
    """A client with all observers, and the chassis's end of its link.

    Attributes:
        goals: names of the goals that count as accepted.
        refusal: text with which the chassis refuses all further requests; empty to accept them.
        late: type of the next request that `answer_late` answers; empty to answer all at once.

    Args:
        info: the first RobotInfo.
        limit: time after which a robot that stands is reported, in seconds.
        overlap: time after which a silent source of velocities no longer drives, in seconds.
        code_delay: maximum time from a refusal to its status code, in seconds.
    """

    def __init__(
        self,
        info: Any,
        limit: float = standstill.LIMIT,
        overlap: float = who_drives.OVERLAP,
        code_delay: float = refusals.CODE_DELAY,
    ) -> None:
        self._limit, self._overlap, self._code_delay = limit, overlap, code_delay
        self.peer = Peer(info=info, script=self._handle)
        self.goals: list[str] = []
        self.refusal = ""
        self.late = ""
        self.unanswered: list[tuple[Wire, Frame]] = []

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[Rig]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(standstill, "LIMIT", self._limit)
            patch.setattr(who_drives, "OVERLAP", self._overlap)
            patch.setattr(refusals, "CODE_DELAY", self._code_delay)
            async with self.peer:
                client = self.client = self.peer.client()
                self.last_known = LastKnown(client)
                self.gate = MotionGate(client, lambda: len(self.goals))
                self.explainer = refusals.RefusalExplainer(client, self.last_known)
                self.watch = Watch(
                    client, self.gate, self.last_known, self.explainer, lambda: self.goals
                )
                async with client:
                    await eventually(lambda: self.last_known.get("woosh.robot.RobotInfo"))
                    self.wire = await self.peer.wire()
                    yield self

    async def send(self, message: Any, source: str = "") -> Answer:
        return await self.gate.request(message, sender=Sender(source))

    async def answer_late(self) -> None:
        """Accept the request of the type `late`."""
        wire, frame = self.unanswered.pop()
        await wire.answer(frame, ok=True)

    async def push(self, message: Any, body: Any) -> None:
        """Push a message, and wait until it has been delivered."""
        seen: list[Any] = []
        end = self.client.subscribe_raw(type(message), seen.append)
        await self.wire.push(message.DESCRIPTOR.full_name, body)
        await eventually(lambda: seen)
        end()

    async def _handle(self, wire: Wire, frame: Frame) -> bool:
        if "sn" not in frame or frame["type"] == "woosh.robot.RobotInfo":
            return False
        if frame["type"] == self.late:
            self.late = ""
            self.unanswered.append((wire, frame))
            return True
        await wire.answer(frame, ok=not self.refusal, msg=self.refusal)
        return True
