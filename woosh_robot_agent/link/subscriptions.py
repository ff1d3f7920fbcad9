"""Who wants which pushes, and their delivery in the order of the wire."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from functools import partial
from typing import Any

from woosh_robot_agent.link.body import Body
from woosh_robot_agent.link.codecs.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.connection import Answer
from woosh_robot_agent.link.drop_log import Losses
from woosh_robot_agent.link.log_once import LogOnce, shown
from woosh_robot_agent.link.push_queue import PushQueue
from woosh_robot_agent.link.stats import LinkStats
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.protos import full_name

_LOG = logging.getLogger(__name__)
_TURN = 0.005
"""s after which the delivery lets others work, so that slow consumers do not starve them."""
_ANSWER = "answer"
"""Name under which answers stand in the queue."""
_SNAPSHOT = "snapshot"
"""Name under which the RobotInfo of a new link stands in the queue."""

COUNTED_PUSHES = tuple(full_name(cls) for cls in (StatusCode, TaskProc, Feedbacks))
"""Types of which each push matters; of the others the newest do."""


class Subscriptions:
    """Takes frames from the reader, and calls those who want them from a task of its own.

    Args:
        depth: how many pushes may wait of each type of which each one matters.
        stats: counters to add to.
        log: for what is told once.
        losses: for what is dropped.
    """

    def __init__(self, depth: int, stats: LinkStats, log: LogOnce, losses: Losses) -> None:
        self._stats = stats
        self._log = log
        self._losses = losses
        self._callbacks: dict[str, list[Callable[[Body], None]]] = {}
        self._snapshot_callbacks: list[Callable[[RobotInfo], None]] = []
        self._depths = {_ANSWER: math.inf}  # of these, as many as requests were made
        self.set_depth(depth)
        self._queue = PushQueue(self._depths, stats.dropped_pushes)

    def set_depth(self, depth: int) -> None:
        """Change how many counted pushes may wait."""
        self._depths.update(dict.fromkeys(COUNTED_PUSHES, depth))

    @property
    def wanted(self) -> list[str]:
        """Types that somebody wants."""
        return [name for name, callbacks in self._callbacks.items() if callbacks]

    def add(self, name: str, callback: Callable[[Body], None]) -> bool:
        """Call `callback` with each push of type `name`; whether it is the first one to want it."""
        callbacks = self._callbacks.setdefault(name, [])
        callbacks.append(callback)
        return len(callbacks) == 1

    def remove(self, name: str, callback: Callable[[Body], None]) -> bool:
        """Call it no more; whether nobody wants the type now."""
        callbacks = self._callbacks[name]
        callbacks.remove(callback)
        return not callbacks

    def on_snapshot(self, callback: Callable[[RobotInfo], None]) -> None:
        """Call `callback` with the RobotInfo of each new link."""
        self._snapshot_callbacks.append(callback)

    # For the reader, which must not wait

    def pushed(self, codec: Codec, envelope: Envelope) -> None:
        """Take a push."""
        name = envelope.type
        if not self._callbacks.get(name):
            if envelope.ok is False:
                self._log.warn(
                    f"error {envelope.msg}", f"the chassis reports: {shown(envelope.msg)}"
                )
            return
        body = Body(codec, envelope, partial(self._skipped, name))
        if not self._queue.put(name, partial(self._deliver, body)):
            self._losses.count(
                f"older {name} gave way to newer ones",
                f"{name} comes faster than it is taken: the oldest are dropped",
            )

    def snapshot(self, answer: Answer) -> None:
        """Take the answer that made the link ready."""
        if answer.ok and isinstance(answer.body, RobotInfo):
            self._queue.put(_SNAPSHOT, partial(self._deliver_snapshot, answer.body))

    def answered(self, tap: Callable[[Answer], None], answer: Answer) -> None:
        """Take an answer that somebody wants in its place among the pushes."""
        self._queue.put(_ANSWER, partial(call, tap, answer))

    # Delivery

    async def dispatch(self) -> None:
        """Deliver, for ever."""
        # those from before a restart belong to another link, perhaps to another event loop
        self._queue = queue = PushQueue(self._depths, self._stats.dropped_pushes)
        now = asyncio.get_running_loop().time
        turn = now()
        while True:
            (await queue.get())()
            if now() - turn > _TURN:
                await asyncio.sleep(0)
                turn = now()

    def _deliver(self, body: Body) -> None:
        for callback in tuple(self._callbacks[body.type]):
            try:
                call(callback, body)
            except FrameError:  # the body has told of it
                return

    def _skipped(self, name: str, error: FrameError) -> None:
        self._stats.bad_frames[error.kind] += 1
        self._log.warn(f"bad push: {name}", f"skipped a push ({error.kind}): {error}")

    def _deliver_snapshot(self, info: RobotInfo) -> None:
        for callback in tuple(self._snapshot_callbacks):
            call(callback, info)


def call(callback: Callable[[Any], None], argument: object) -> None:
    """Call a consumer. Its mistake is logged, and ends nothing; a body's, FrameError, is raised."""
    try:
        callback(argument)
    except FrameError:
        raise
    except (Exception, asyncio.CancelledError):  # the latter is none of ours: nothing awaits here
        _LOG.exception("a callback failed")
