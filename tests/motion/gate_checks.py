"""A motion gate with a scripted chassis behind a real socket, and helpers of its tests."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from tests.link.link_peer import INFO, TIMEOUT, Frame, Peer, Wire, eventually, soon, turns
from tests.motion.moving import MOVING
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.motion import MotionGate, MotionTiming
from woosh_robot_agent.motion.gate import cancel_orders
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

TWIST = "woosh.robot.Twist"
FEEDBACKS = "woosh.ros.Feedbacks"
ORDERS = len(cancel_orders()) + 1
"""Number of requests of a stop."""
NEVER = 3600.0
"""A time that does not pass during a test, however slow the machine is, in seconds."""

RUNNING = {"robotTaskId": "7", "state": "kExecuting"}
"""Body of a report on a task that drives the robot."""

BACKOFF = {"backoff_min": 0.05, "backoff_max": 0.05}

Script = Callable[[Wire, Frame], Awaitable[bool]]
"""What a chassis does with a frame; returns True if it has handled it."""


def feedback(action: str, state: str) -> Frame:
    """Return the body of a report on an action."""
    return {"fbs": [{"action": f"woosh.ros.action.{action}", "state": state}]}


async def answer_all(wire: Wire, frame: Frame) -> bool:
    """Accept every request; a script for `Peer`."""
    if frame["type"] not in (INFO, FEEDBACKS) and "sn" in frame:
        await wire.answer(frame)
        return True
    return False


def refusing(is_refused: Callable[[Frame], bool], msg: str = "Request failed") -> Script:
    """Return a script that refuses some requests, and accepts all others."""

    async def script(wire: Wire, frame: Frame) -> bool:
        if "sn" in frame and frame["type"] != INFO and is_refused(frame):
            await wire.answer(frame, ok=False, msg=msg)
            return True
        return await answer_all(wire, frame)

    return script


def is_task_order(frame: Frame) -> bool:
    return bool(frame["type"] == "woosh.robot.ActionOrder")


async def answer_nothing(wire: Wire, frame: Frame) -> bool:
    """Leave the answers to the test; a script for `Peer`."""
    return False


@dataclass
class Rig:
    """A motion gate, its client, and the chassis's end of the link.

    Attributes:
        actions: body of the chassis's answer to the query of the actions; None to refuse it.
    """

    peer: Peer
    client: ChassisClient
    gate: MotionGate
    wire: Wire
    actions: Frame | None

    def drive(self, speed: float, **options: Any) -> asyncio.Task[Any]:
        return asyncio.ensure_future(self.gate.request(Twist(linear=speed), **options))

    async def tell(self, push: str, body: Frame) -> None:
        """Let the chassis push a report, and wait until the gate has handled it."""
        before = self.client.stats.rx
        await self.wire.push(push, body)
        await eventually(lambda: self.client.stats.rx > before)
        await turns()

    async def second_wire(self) -> Wire:
        """Return the chassis's end of the second link, once it is ready."""
        self.wire = await self.peer.wire(2)
        await self.client.wait_ready(TIMEOUT)
        return self.wire


@asynccontextmanager
async def gated(
    script: Script = answer_all,
    link: dict[str, Any] | None = None,
    goals: Callable[[], int] = lambda: 0,
    **timing: float,
) -> AsyncIterator[Rig]:
    """Run a gate that is connected to a chassis.

    Args:
        script: what the chassis does with a frame; by default it accepts every request.
        link: fields of `LinkConfig`.
        goals: number of open goals.
        timing: fields of `MotionTiming`; a stop holds, and a velocity drives and is new, until the
            end of the test.
    """
    rig: Rig | None = None

    async def script_with_actions(wire: Wire, frame: Frame) -> bool:
        if await script(wire, frame):
            return True
        if frame["type"] != FEEDBACKS:
            return False
        actions = {} if rig is None else rig.actions
        await wire.answer(frame, actions, ok=actions is not None)
        return True

    times = {"hold": NEVER, "driving": NEVER, "max_age": NEVER, "unanswered": NEVER, **timing}
    config = {**BACKOFF, **(link or {})}
    async with Peer(script=script_with_actions) as peer, peer.client(**config) as client:
        gate = MotionGate(client, goals)
        gate.timing = MotionTiming(**times)
        rig = Rig(peer, client, gate, await peer.wire(), actions={})
        yield rig


def types(wire: Wire) -> list[str]:
    """Return the types of the received requests that may move the robot or end a motion."""
    wanted = {TWIST, "woosh.robot.ActionOrder", *(each.DESCRIPTOR.full_name for each in MOVING)}
    return [frame["type"] for frame in wire.seen if frame["type"] in wanted]


def speeds(wire: Wire) -> list[float]:
    """Return the speeds ahead that the chassis has received."""
    return [frame["body"].get("linear", 0) for frame in wire.seen if frame["type"] == TWIST]


async def ok(work: Awaitable[Any]) -> None:
    assert (await soon(asyncio.ensure_future(work))).ok
