"""Subscriptions to pushes, and the delivery of pushes to their consumers in order of arrival."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from functools import partial

from woosh_robot_agent.link.answer import Answer
from woosh_robot_agent.link.body import Body
from woosh_robot_agent.link.callbacks import call, call_plain
from woosh_robot_agent.link.codecs.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.drop_log import DropLog
from woosh_robot_agent.link.log_once import LogOnce, one_line
from woosh_robot_agent.link.push_queue import PushQueue
from woosh_robot_agent.link.robot_identity import RobotIdentity
from woosh_robot_agent.link.stats import LinkStats
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.protos import full_name

_LOG = logging.getLogger(__name__)
_TIME_SLICE = 0.005
"""Time after which the delivery lets other tasks run, in seconds, so that slow consumers do not
starve them."""
_ANSWER = "answer"
"""Name of answers in the queue."""
_SNAPSHOT = "snapshot"
"""Name of the first RobotInfo of a link in the queue."""

COUNTED_PUSHES = tuple(full_name(cls) for cls in (StatusCode, TaskProc, Feedbacks))
"""Types of which every push must be delivered. Of other types, only the newest values matter."""


class Subscriptions:
    """Queues the pushes that were read, and calls their consumers from a separate task.

    Args:
        depth: maximum number of queued pushes for each of `COUNTED_PUSHES`.
        stats: counters to add to.
        log: log for errors that the chassis reports, and for pushes that cannot be read.
        drops: log for dropped pushes.
    """

    def __init__(self, depth: int, stats: LinkStats, log: LogOnce, drops: DropLog) -> None:
        self._stats = stats
        self._log = log
        self._drops = drops
        self._callbacks: dict[str, list[Callable[[Body], None]]] = {}
        """Consumers of pushes, by type."""
        self._snapshot_callbacks: list[Callable[[RobotInfo], None]] = []
        self._robot_changed_callbacks: list[Callable[[], None]] = []
        self._robot: RobotIdentity | None = None
        """The robot of the last link; None before the first one."""
        self.robot_changes = 0
        """Number of times that the link turned to another robot."""
        self._depths = {_ANSWER: math.inf}  # the number of requests limits them
        """Maximum number of queued pushes, by type."""
        self.set_depth(depth)
        self._queue = PushQueue(self._depths, stats.dropped_pushes)
        self._held: PushQueue | None = None
        """Pushes and answers of a connection whose handshake is in progress."""

    def set_depth(self, depth: int) -> None:
        """Change the maximum number of queued pushes for each of `COUNTED_PUSHES`."""
        self._depths.update(dict.fromkeys(COUNTED_PUSHES, depth))

    @property
    def queued(self) -> int:
        """Number of queued pushes and answers."""
        return len(self._queue) + (0 if self._held is None else len(self._held))

    # Consumers

    @property
    def wanted(self) -> list[str]:
        """Types that have a consumer."""
        return [name for name, callbacks in self._callbacks.items() if callbacks]

    def add(self, name: str, callback: Callable[[Body], None]) -> bool:
        """Call `callback` with each push of type `name`.

        Returns:
            True if it is the first consumer of this type.
        """
        callbacks = self._callbacks.setdefault(name, [])
        callbacks.append(callback)
        return len(callbacks) == 1

    def remove(self, name: str, callback: Callable[[Body], None]) -> bool:
        """End a subscription.

        Returns:
            True if the type no longer has a consumer.
        """
        callbacks = self._callbacks[name]
        callbacks.remove(callback)
        return not callbacks

    def on_snapshot(self, callback: Callable[[RobotInfo], None]) -> None:
        """Call `callback` with the first RobotInfo of each link."""
        self._snapshot_callbacks.append(callback)

    def on_robot_changed(self, callback: Callable[[], None]) -> None:
        """Call `callback` when the link turns to another robot."""
        self._robot_changed_callbacks.append(callback)

    # Start of a connection, and change to another robot

    def hold(self) -> None:
        """Hold back what arrives from now on, until it is known which robot sends it."""
        self._held = PushQueue(self._depths, self._stats.dropped_pushes)

    def release(self) -> None:
        """Deliver what was held back, and what arrives from now on; idempotent."""
        held, self._held = self._held, None
        for name, deliver in () if held is None else held.take_all():
            self._queue.put(name, deliver)

    def discard_held(self) -> None:
        """Discard what was held back: the handshake failed."""
        self._held = None

    def forget_robot(self) -> None:
        """Discard all that waits for its consumers, and tell them that the robot is another one."""
        self._robot = None
        self.robot_changes += 1
        self._queue.take_all()
        for callback in tuple(self._robot_changed_callbacks):
            call_plain(callback)

    # Called by the reader; these methods never wait

    def put_push(self, codec: Codec, envelope: Envelope, alone: bool = False) -> None:
        """Deliver or queue a push if it has a consumer.

        Args:
            codec: codec of the connection.
            envelope: the push.
            alone: deliver it at once if nothing is queued, which saves a turn of the event loop.
                Pushes that arrive together are queued, so that the oldest can be dropped.
        """
        name = envelope.type
        if not self._callbacks.get(name):
            if envelope.ok is False:
                self._log.warn(
                    f"error {envelope.msg}", f"the chassis reports: {one_line(envelope.msg)}"
                )
            return
        body = Body(codec, envelope, partial(self._count_bad, name))
        if alone and self._held is None and not self._queue:
            self._deliver(body)
        elif not self._target.put(name, partial(self._deliver, body)):
            self._drops.count(
                f"pushes of {name} were dropped",
                f"{name} arrives faster than its consumers handle it; dropping the oldest pushes",
            )

    def put_snapshot(self, answer: Answer) -> None:
        """Queue the first RobotInfo of a link, after what was held back until it is known."""
        if answer.ok and isinstance(answer.body, RobotInfo):
            self._identify(answer.body)
            self.release()
            self._queue.put(_SNAPSHOT, partial(self._deliver_snapshot, answer.body))

    def put_answer(self, tap: Callable[[Answer], None], answer: Answer) -> None:
        """Queue an answer for `tap`, in order with the pushes."""
        self._target.put(_ANSWER, partial(call, tap, answer))

    @property
    def _target(self) -> PushQueue:
        return self._queue if self._held is None else self._held

    def _identify(self, info: RobotInfo) -> None:
        """Compare the robot of a new link with that of the link before."""
        robot = RobotIdentity.of(info)
        if self._robot is not None and self._robot.differs_from(robot):
            _LOG.warning(
                "another robot answers now: %s instead of %s; everything that the former one "
                "reported is forgotten",
                robot,
                self._robot,
            )
            self.forget_robot()
        self._robot = robot

    # Delivery

    async def deliver(self) -> None:
        """Deliver queued pushes and answers until cancelled."""
        # pushes that an earlier run left in the queue belong to another link
        self._queue = queue = PushQueue(self._depths, self._stats.dropped_pushes)
        now = asyncio.get_running_loop().time
        slice_started = now()
        while True:
            (await queue.get())()
            if now() - slice_started > _TIME_SLICE:
                await asyncio.sleep(0)
                slice_started = now()

    def _deliver(self, body: Body) -> None:
        for callback in tuple(self._callbacks[body.type]):
            try:
                call(callback, body)
            except FrameError:  # `_count_bad` has logged it
                return

    def _count_bad(self, name: str, error: FrameError) -> None:
        self._stats.bad_frames[error.kind] += 1
        self._log.warn(f"bad push: {name}", f"skipped a push ({error.kind}): {error}")

    def _deliver_snapshot(self, info: RobotInfo) -> None:
        for callback in tuple(self._snapshot_callbacks):
            call(callback, info)
