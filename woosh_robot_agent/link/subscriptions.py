"""Subscriptions to pushes, and the delivery of pushes to their consumers in order of arrival."""

from __future__ import annotations

import asyncio
import logging
import math
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from woosh_robot_agent.link.frames import Answer, Body, Codec, Envelope, FrameError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import LinkRecord, one_line
from woosh_robot_agent.link.tasks import offload
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks

_LOG = logging.getLogger(__name__)


def call_logged(
    callback: Callable[[Any], None],
    argument: object,
    raised: tuple[type[Exception], ...] = (),
) -> None:
    """Call a callback; log its exceptions, so that they do not end the caller's task.

    Exceptions of the types in `raised` are raised instead.
    """
    try:
        callback(argument)
    except raised:
        raise
    except (Exception, asyncio.CancelledError):  # no cancellation: nothing is awaited here
        _LOG.exception("a callback failed")


EVENT_PUSHES = tuple(full_name(cls) for cls in (StatusCode, TaskProc, Feedbacks))
"""Types of pushes about events, which must all be delivered. Of other types, only the newest values
matter."""
LATEST_DEPTH = 50
"""Maximum number of queued pushes of a type not in EVENT_PUSHES. Enough at 3000 Hz while another
program uses the core for 17 ms."""

Deliver = Callable[[], Awaitable[None] | None]
"""Delivers a push or an answer. It returns an awaitable if later pushes must wait for its end."""


class PushQueue:
    """A queue of pushes in the order of their arrival, with a limit for each type.

    Args:
        depths: maximum number of queued pushes, by type; `LATEST_DEPTH` for all other types.
        dropped: counter of drops, by type.
    """

    def __init__(self, depths: Mapping[str, float], dropped: Counter[str]) -> None:
        self._depths = depths
        self._dropped = dropped
        self._queue: deque[tuple[str, Deliver]] = deque()
        """The type of each push, and the function that delivers it."""
        self._waiting: dict[str, int] = {}
        """Number of queued pushes, by type."""
        self._not_empty = asyncio.Event()

    def __len__(self) -> int:
        return len(self._queue)

    def put(self, name: str, deliver: Deliver) -> bool:
        """Add a push of type `name`, as the function that delivers it.

        Returns:
            False if the oldest push of this type was dropped to make room.
        """
        waiting = self._waiting.get(name, 0)
        fits = waiting < self._depths.get(name, LATEST_DEPTH)
        if fits:
            self._waiting[name] = waiting + 1
        else:
            self._dropped[name] += 1
            self._discard_oldest(name)
        self._queue.append((name, deliver))
        self._not_empty.set()
        return fits

    async def wait(self) -> None:
        """Wait until there is a push."""
        while not self._queue:
            self._not_empty.clear()
            await self._not_empty.wait()

    def get(self) -> Deliver:
        """Remove the next push, and return the function that delivers it; there must be one."""
        name, deliver = self._queue.popleft()
        self._waiting[name] -= 1
        return deliver

    def take_all(self) -> list[tuple[str, Deliver]]:
        """Remove all pushes; return their types and the functions that deliver them."""
        pushes = list(self._queue)
        self._queue.clear()
        self._waiting.clear()
        return pushes

    def _discard_oldest(self, name: str) -> None:
        """Remove the oldest push of a type; `_waiting` stays, because a new one takes its place."""
        for index, (queued, _) in enumerate(self._queue):
            if queued == name:
                del self._queue[index]
                return


_TIME_SLICE = 0.005
"""Time after which the delivery lets other tasks run, in seconds, so that slow consumers do not
starve them."""
_ANSWER = "answer"
"""Type under which answers, and the ends of `wait_delivered`, are queued."""
_SNAPSHOT = "snapshot"
"""Type under which the first RobotInfo of a link is queued."""


class Consumer(NamedTuple):
    """A consumer of the pushes of one type, or of the first RobotInfo of each connection.

    Attributes:
        callback: called in the event loop.
        prepare: converts the body of a push, or the RobotInfo, into the argument of `callback`. A
            large one is converted in the thread for large messages.
    """

    callback: Callable[[Any], None]
    prepare: Callable[[Any], Any]

    def take(self, value: Body | RobotInfo) -> None:
        """Prepare a small push or RobotInfo, and call the callback."""
        self.callback(self.prepare(value))


class Subscriptions:
    """Delivers pushes to their consumers.

    A push that arrives alone is delivered at once if nothing is queued. Other pushes are queued,
    and a separate task delivers them. Large pushes are prepared in another thread; meanwhile,
    later pushes of the same type wait in a queue of this type.

    Args:
        depth: maximum number of queued pushes for each of `EVENT_PUSHES`.
    """

    def __init__(self, depth: int, record: LinkRecord) -> None:
        self._stats = record.stats
        self._log = record.log
        self._drops = record.drops
        self._consumers: dict[str, list[Consumer]] = {}
        """Consumers of pushes, by type."""
        self._snapshot_consumers: list[Consumer] = []
        # the number of requests limits that of the answers
        self._depths = {_ANSWER: math.inf, **dict.fromkeys(EVENT_PUSHES, depth)}
        """Maximum number of queued pushes, by type."""
        self._queue = PushQueue(self._depths, self._stats.dropped_pushes)
        self._type_queues: dict[str, deque[Body]] = {}
        """Large pushes that wait to be prepared, and later pushes of the same type, by type."""
        self._type_tasks: set[asyncio.Task[None]] = set()
        """Tasks that prepare and deliver these pushes, one for each type."""
        self._preparing = False
        """True while a large RobotInfo is prepared; later pushes wait in the queue."""
        self._held: PushQueue | None = None
        """Pushes and answers that arrive during a handshake; None after it."""

    @property
    def queued(self) -> int:
        """Number of queued pushes and answers."""
        waiting = len(self._queue) + sum(map(len, self._type_queues.values()))
        return waiting + (0 if self._held is None else len(self._held))

    # Consumers

    @property
    def wanted(self) -> list[str]:
        """Types that have a consumer."""
        return [name for name, consumers in self._consumers.items() if consumers]

    def add(self, name: str, consumer: Consumer) -> bool:
        """Deliver each push of type `name` to a consumer.

        Returns:
            True if it is the first consumer of this type.
        """
        consumers = self._consumers.setdefault(name, [])
        consumers.append(consumer)
        return len(consumers) == 1

    def remove(self, name: str, consumer: Consumer) -> bool:
        """End a subscription.

        Returns:
            True if the type no longer has a consumer.
        """
        consumers = self._consumers[name]
        consumers.remove(consumer)
        return not consumers

    def on_snapshot(self, consumer: Consumer) -> None:
        """Deliver the first RobotInfo of each connection to a consumer."""
        self._snapshot_consumers.append(consumer)

    # Start of a connection

    def hold(self) -> None:
        """Hold back pushes and answers from now on, until it is known which robot sends them.

        Large pushes that are not prepared yet belong to another link, and are discarded.
        """
        self._clear_type_queues()
        self._held = PushQueue(self._depths, self._stats.dropped_pushes)

    def release(self) -> None:
        """Stop holding back, and queue what was held back; idempotent."""
        held, self._held = self._held, None
        if held is not None:
            for name, deliver in held.take_all():
                self._queue.put(name, deliver)

    def discard_held(self) -> None:
        """Discard what was held back. After a successful handshake, nothing is held back."""
        self._held = None

    # Called by the reader of the connection; these methods never wait

    def put_push(self, codec: Codec, envelope: Envelope, alone: bool) -> None:
        """Deliver or queue a push if it has a consumer.

        Args:
            alone: True if no other frame was waiting to be read. Then the push is delivered at
                once if nothing is queued, which saves a turn of the event loop. Pushes that arrive
                together are queued, so that the oldest can be dropped.
        """
        name = envelope.type
        if not self._consumers.get(name):
            if envelope.ok is False:  # an error that belongs to no request
                self._log.warn(
                    f"error {envelope.msg}", f"the chassis reports: {one_line(envelope.msg)}"
                )
            return
        body = Body(codec, envelope, partial(self._count_bad, name))
        if alone and self._held is None and not self._queue and not self._preparing:
            self._deliver(body)
        elif not self._target.put(name, partial(self._deliver, body)):
            self._drops.warn(
                name,
                f"{name} arrives faster than its consumers handle it; dropping the oldest pushes",
            )

    def put_snapshot(self, answer: Answer) -> None:
        """Queue the pushes that were held back and a new link's RobotInfo, if that is readable."""
        if answer.ok and isinstance(answer.body, RobotInfo):
            self.release()
            self._queue.put(_SNAPSHOT, partial(self._deliver_snapshot, answer))

    def put_answer(self, tap: Callable[[Answer], None], answer: Answer) -> None:
        """Queue an answer for `tap`, in order with the pushes."""
        self._target.put(_ANSWER, partial(call_logged, tap, answer))

    async def wait_delivered(self) -> None:
        """Wait until everything received so far is delivered, except for large pushes."""
        delivered = asyncio.Event()
        self._target.put(_ANSWER, delivered.set)
        await delivered.wait()

    @property
    def _target(self) -> PushQueue:
        """The queue for pushes and answers that arrive now."""
        return self._queue if self._held is None else self._held

    # Delivery

    async def deliver(self) -> None:
        """Deliver queued pushes and answers until cancelled."""
        # pushes that an earlier run left in the queue belong to another link
        self._queue = queue = PushQueue(self._depths, self._stats.dropped_pushes)
        now = asyncio.get_running_loop().time
        slice_started = now()
        try:
            while True:
                if not len(queue):
                    await queue.wait()
                    slice_started = now()  # other tasks ran meanwhile
                # no variable for the function: it would keep a large push in memory
                unfinished = queue.get()()
                if unfinished is not None:  # later pushes must wait for its end
                    await unfinished
                if now() - slice_started > _TIME_SLICE:
                    await asyncio.sleep(0)
                    slice_started = now()
        finally:
            self._preparing = False
            self._clear_type_queues()

    def _clear_type_queues(self) -> None:
        """Discard the large pushes that are not prepared yet, and the pushes behind them."""
        for task in self._type_tasks:
            task.cancel()
        self._type_queues.clear()

    def _deliver(self, body: Body) -> None:
        """Deliver a push; queue it for its type if it is large, or an earlier large one waits."""
        queue = self._type_queues.get(body.type)
        if queue is not None:
            if len(queue) == queue.maxlen:  # then `append` discards the oldest push
                self._stats.dropped_pushes[body.type] += 1
            queue.append(body)
        elif body.is_large:
            limit = int(self._depths.get(body.type, LATEST_DEPTH))
            self._type_queues[body.type] = queue = deque([body], limit)
            work = self._deliver_type(body.type, queue)
            task = asyncio.get_running_loop().create_task(work, name=f"large {body.type}")
            self._type_tasks.add(task)
            task.add_done_callback(self._type_tasks.discard)
        else:
            self._deliver_now(body)

    def _deliver_now(self, body: Body) -> None:
        """Call the consumers of a push, up to the first one that cannot read its body."""
        for consumer in tuple(self._consumers[body.type]):
            try:
                call_logged(consumer.take, body, raised=(FrameError,))
            except FrameError:  # `_count_bad` has logged it
                return

    async def _deliver_type(self, name: str, queue: deque[Body]) -> None:
        """Deliver queued pushes of a type; prepare large ones in the thread for large messages."""
        while queue:
            body = queue.popleft()
            if body.is_large:
                await self._deliver_large(body, self._consumers[name])
            else:
                self._deliver_now(body)
        self._type_queues.pop(name, None)

    async def _deliver_large(self, value: Body | RobotInfo, consumers: list[Consumer]) -> None:
        """Prepare a value in the thread for large messages, and call the consumers."""
        for consumer in tuple(consumers):
            try:
                prepared = await offload(consumer.prepare, value)
                call_logged(consumer.callback, prepared, raised=(FrameError,))
            except FrameError:  # `_count_bad` has logged it
                return
            except Exception:
                _LOG.exception("a callback failed")

    def _count_bad(self, name: str, error: FrameError) -> None:
        """Count and log a push of type `name` that cannot be read."""
        self._stats.bad_frames[error.kind] += 1
        self._log.warn(f"bad push: {name}", f"skipped a push ({error.kind}): {error}")

    def _deliver_snapshot(self, answer: Answer) -> Awaitable[None] | None:
        """Deliver the first RobotInfo; return an awaitable for a large one, which takes time."""
        if answer.raw.is_large:
            return self._deliver_large_snapshot(answer.raw.message())
        for consumer in tuple(self._snapshot_consumers):
            call_logged(consumer.take, answer.body)
        return None

    async def _deliver_large_snapshot(self, info: RobotInfo) -> None:
        """Deliver a large RobotInfo; pushes wait in the queue meanwhile."""
        self._preparing = True
        await self._deliver_large(info, self._snapshot_consumers)
        self._preparing = False
