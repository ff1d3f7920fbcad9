"""A simulated chassis with a client that records all frames, with their simulated times."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

from tests.simulator.sim_wire import AskingClient, Json
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.protocol.reports import TOPICS
from woosh_robot_agent.simulator.serving.exchange import Client, MessageHandler

SCANNER_DATA = "woosh.robot.ScannerData"

_TOPICS = sorted(TOPICS - {SCANNER_DATA})
"""Topics to which the client is subscribed from the start."""
_WAIT_TIMEOUT = 300.0
"""Maximum simulated time until a frame, in seconds."""


class Frame(NamedTuple):
    """A frame of the chassis.

    Attributes:
        time: simulated time at which it was sent, in seconds since the start.
        sn: serial number of an answer, 0 for a push.
        type: full name of the body.
        body: the body.
        ok: True if the request was accepted; None for a push.
    """

    time: float
    sn: int
    type: str
    body: Json
    ok: bool | None


def wait_frame(chassis: SteppedChassis, wanted: Callable[[Frame], Any], after: int = 0) -> Frame:
    """Let simulated time pass until the first frame that is `wanted`, and return it.

    Args:
        chassis: the chassis.
        wanted: returns True for the frame.
        after: number of first frames that do not count.
    """
    seen = after
    for _ in range(round(_WAIT_TIMEOUT / TIME_STEP)):
        found = next((frame for frame in chassis.frames[seen:] if wanted(frame)), None)
        if found:
            return found
        seen = max(seen, len(chassis.frames))
        chassis.run(TIME_STEP)
    raise AssertionError(f"no such frame among {chassis.frames[after:]}")


def answer_to(chassis: SteppedChassis, type_name: str, **body: Any) -> Frame:
    """Send a request, wait for its answer, and return it."""
    sn = chassis.request(type_name, **body)
    return wait_frame(chassis, lambda frame: frame.sn == sn)


_BODIES: dict[str, Json] = {
    "woosh.robot.InitRobot": {"isRecord": True},
    "woosh.robot.SwitchWorkMode": {"mode": 2},
}
"""Bodies of requests whose answers are timed; all others are empty."""


def answer_times(type_name: str, count: int) -> list[float]:
    """Return the times of the answers to `count` requests of a type, shortest first.

    Each request is sent after the answer to the one before, whether that was accepted or refused.
    """
    chassis = SteppedChassis()
    found = []
    for _ in range(count):
        sent = chassis.chassis.elapsed
        found.append(answer_to(chassis, type_name, **_BODIES.get(type_name, {})).time - sent)
    return sorted(found)


def ask(chassis: SteppedChassis, type_name: str, **body: Any) -> Frame:
    """Return the answer to a request, which must be ok."""
    answer = answer_to(chassis, type_name, **body)
    assert answer.ok, answer
    return answer


class SteppedChassis(Client):
    """A chassis that is stepped by hand, and its client: exact times, without sockets and waiting.

    Args:
        options: options of `SimulatorConfig`.

    Attributes:
        chassis: the model of the robot.
        frames: all frames for the client, oldest first.
        raw: the same frames, as the client receives them.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(None, 0)  # type: ignore[arg-type]
        self.chassis = Chassis(SimulatorConfig(**{"seed": 1, **options}))
        self.frames: list[Frame] = []
        self.raw: list[Json] = []
        self._handler = MessageHandler(self.chassis)
        self._handler.join(self)
        self._sn = 0
        self.subscribe(*_TOPICS)

    def subscribe(self, *topics: str) -> None:
        self._receive({"type": "woosh.Subscription", "body": {"topics": list(topics), "sub": True}})

    def send(self, frame: str | bytes) -> None:
        raw = json.loads(frame)
        self.raw.append(raw)
        self.frames.append(
            Frame(self.chassis.elapsed, raw.get("sn", 0), raw["type"], raw["body"], raw.get("ok"))
        )

    def request(self, type_name: str, **body: Any) -> int:
        """Send a request, and return its serial number."""
        self._sn += 1
        self._receive({"type": type_name, "body": body, "sn": self._sn})
        return self._sn

    def run(self, seconds: float) -> None:
        """Let simulated time pass."""
        for _ in range(round(seconds / TIME_STEP)):
            self.chassis.tick(TIME_STEP)
            self._handler.report_changes(while_moving=True)

    def _receive(self, frame: Json) -> None:
        self._handler.receive(self, json.dumps(frame))


def pushed(chassis: SteppedChassis, type_name: str) -> list[Frame]:
    """Return all pushes of a type."""
    return [frame for frame in chassis.frames if frame.type == type_name and not frame.sn]


class SteppedClient(AskingClient):
    """A client of a chassis that does everything at once, and that is stepped by hand.

    Simulated time passes only in `run`, `receive` and `next_push`, so that a test misses nothing.

    Args:
        options: options of `SimulatorConfig`.

    Attributes:
        chassis: the model of the robot.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__()
        self._stepped = SteppedChassis(**{"profile": "instant", **options})
        self.chassis = self._stepped.chassis
        self._topics: set[str] = set()
        self._taken = 0
        """Number of frames that were answers, pushes in `pushes`, or not subscribed to."""

    def subscribe(self, *topics: str) -> None:
        self._topics |= set(topics)

    def request(self, type_name: str, body: Json | None = None) -> Json:
        sn = self._stepped.request(type_name, **(body or {}))
        while not (answer := self._take(sn)):
            self._stepped.run(TIME_STEP)
        return answer

    def run(self, seconds: float) -> None:
        """Let simulated time pass."""
        self._stepped.run(seconds)
        self._take()

    def receive(self) -> Json:
        self._take()
        for _ in range(round(_WAIT_TIMEOUT / TIME_STEP)):
            if self.pushes:
                return self.pushes.popleft()
            self.run(TIME_STEP)
        raise AssertionError("nothing is pushed")

    def _take(self, sn: int = 0) -> Json | None:
        """Move pushes to `pushes`, all or those before an answer; return the answer."""
        while self._taken < len(self._stepped.raw):
            frame = self._stepped.raw[self._taken]
            self._taken += 1
            if "sn" in frame and frame["sn"] == sn:
                return frame
            if "sn" not in frame and frame["type"] in self._topics:
                self.pushes.append(frame)
        return None
