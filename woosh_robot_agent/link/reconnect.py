"""Connect to the chassis, make the handshake, report the link's state, and reconnect.

No other module retries to connect.
"""

from __future__ import annotations

import asyncio
import logging
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial

from woosh_robot_agent.link.codecs import client_codec
from woosh_robot_agent.link.config import (
    ConnectionLostError,
    HandshakeError,
    LinkConfig,
    LinkError,
    NotConnectedError,
    OtherRobotError,
)
from woosh_robot_agent.link.connection import Connection, Sending
from woosh_robot_agent.link.frames import Answer
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import LinkRecord, one_line, system_text
from woosh_robot_agent.link.subscriptions import Subscriptions, call_logged
from woosh_robot_agent.link.tasks import cancel_and_wait, run_with_timeout
from woosh_robot_agent.link.transport import Transport, TransportClosedError, open_transport
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.sentences import REFUSED, Sentence, said_by

_NOT_CONNECTED = Sentence(
    "not connected to {address} since {since} ({why}); check that the robot is on, that `ip` and "
    "`port` are right, and that the network reaches it"
)
_LAST_ERROR = Sentence("last error: {error}")
_NO_ATTEMPT = Sentence("no attempt has ended yet")
_UNREACHABLE = Sentence("{reason}")  # translations put words before the reason
_OTHER_ROBOT = Sentence(
    "{robot} answers instead of {expected}; commands go only to the robot that answered first: "
    "connect that one, or restart this program to use the other one"
)
_ROBOT = Sentence("robot {id} (serial number {serial})")
_OTHER_TYPE = Sentence("another type of answer")()
_NO_INFO = Sentence("the chassis did not send its RobotInfo: {reason}")
_CLOSED = Sentence("the link was closed")
_JITTER = 0.2
"""Maximum share by which a pause is shortened at random, so that many agents do not retry in
step."""


class Backoff:
    """Pauses with jitter that double each time, until reset.

    Args:
        shortest: first pause, in seconds.
        longest: longest pause, in seconds.
    """

    def __init__(self, shortest: float, longest: float) -> None:
        self._shortest = shortest
        self._longest = longest
        self._next = shortest

    def next(self) -> float:
        """Return the pause before the next attempt, in seconds."""
        pause = self._next
        self._next = min(self._longest, pause * 2)
        return pause * (1 - _JITTER * random.random())

    def reset(self) -> None:
        """Start again with the shortest pause."""
        self._next = self._shortest


class LinkState(Enum):
    """State of the link."""

    STOPPED = "stopped"
    """Not started, or closed: no attempt to connect is made."""
    CONNECTING = "connecting"
    """An attempt is in progress: the transport is opening, or the first RobotInfo is pending."""
    READY = "ready"
    """The first RobotInfo has been delivered; requests can be sent."""
    WAITING = "waiting"
    """The last attempt failed, or the link was lost; the next attempt follows after a pause."""


@dataclass(frozen=True)
class RobotIdentity:
    """The identity of a robot.

    Attributes:
        robot_id: id of the robot; 0 if it reports no id.
        serial_number: serial number of the robot; 0 if it reports none.
    """

    robot_id: int = 0
    serial_number: int = 0

    @classmethod
    def of(cls, info: RobotInfo) -> RobotIdentity:
        """Return the identity of the robot that sent `info`."""
        return cls(info.robot_id, info.genral.serial_number)  # the manufacturer spells it so

    def __str__(self) -> str:
        return _ROBOT(id=self.robot_id, serial=self.serial_number)

    def differs_from(self, other: RobotIdentity) -> bool:
        """Return True if both report an id, or both a serial number, and the two numbers differ."""
        pairs = (
            (self.robot_id, other.robot_id),
            (self.serial_number, other.serial_number),
        )
        return any(mine and others and mine != others for mine, others in pairs)

    def completed_by(self, other: RobotIdentity) -> RobotIdentity:
        """Return this identity, with unknown numbers taken from `other`."""
        return RobotIdentity(
            self.robot_id or other.robot_id, self.serial_number or other.serial_number
        )


_RETRY_AFTER = 1.0
"""Time without an answer after which RobotInfo is requested once more, in seconds."""


async def open_link(config: LinkConfig) -> Transport:
    """Connect to the chassis.

    Raises:
        NotConnectedError: nothing answers at the address.
        HandshakeError: the other end does not speak the configured transport.
    """
    try:
        return await open_transport(config)
    except OSError as error:
        raise NotConnectedError(_UNREACHABLE(reason=system_text(error))) from None
    except TransportClosedError as error:
        raise HandshakeError(said_by(error)) from None


def _identity_in(answer: Answer) -> RobotIdentity:
    """Return the identity in a RobotInfo, without numbers if the RobotInfo cannot be read."""
    info = answer.body
    return RobotIdentity.of(info) if answer.ok and isinstance(info, RobotInfo) else RobotIdentity()


_LOG = logging.getLogger(__name__)


class ReconnectLoop:
    """Connects to the chassis, and again whenever the connection ends, until stopped.

    There is never more than one connection.

    Args:
        subscriptions: renewed on each connection; gets the pushes.

    Attributes:
        connection: the connection, from the handshake to its end; None if there is none.
        state: state of the link.
        since: as `ChassisClient.since`.
        last_error: as `ChassisClient.last_error`.
    """

    def __init__(
        self,
        config: LinkConfig,
        subscriptions: Subscriptions,
        record: LinkRecord,
    ) -> None:
        self.config = config
        self.connection: Connection | None = None
        self.state = LinkState.STOPPED
        self.since = time.time()
        self.last_error: LinkError | None = None
        self._callbacks: list[Callable[[LinkState], None]] = []
        self._ready_waiters: set[asyncio.Future[None]] = set()
        self._subscriptions = subscriptions
        self._record = record
        self._log = record.log
        self._current: asyncio.Task[None] | None = None
        """The task that connects; None when stopped."""
        self._tasks: set[asyncio.Task[None]] = set()
        """The current task, and cancelled tasks that are closing their connection."""
        self._robot = RobotIdentity()
        """The robot of all links, as far as it is known."""

    @property
    def running(self) -> bool:
        """True between `start` and `stop`."""
        return self._current is not None

    @property
    def task_count(self) -> int:
        """Number of tasks that have not ended."""
        return len(self._tasks)

    def start(self) -> None:
        """Start connecting."""
        task = asyncio.get_running_loop().create_task(self._run(), name="link to the chassis")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._current = task

    async def stop(self) -> None:
        """Stop connecting and close the connection, within `close_timeout`."""
        self._current = None
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)
        # `start` may have been called during the wait
        if not self.running and self.state is not LinkState.STOPPED:
            self._enter(LinkState.STOPPED)

    async def reconfigure(self, config: LinkConfig) -> None:
        """Apply a new configuration; reconnect if a changed field requires it."""
        previous, self.config = self.config, config
        if self.connection is not None:
            self.connection.config = config
        if self._current is not None and not config.keeps_connection(previous):
            self._log.clear()  # problems of the new connection are logged again
            earlier = tuple(self._tasks)
            self._current.cancel()
            self.start()
            if earlier:
                await asyncio.wait(earlier)

    def on_change(self, callback: Callable[[LinkState], None]) -> None:
        """Call `callback` with each new state, in the event loop."""
        self._callbacks.append(callback)

    def _enter(self, state: LinkState) -> None:
        """Change the state, and notify callbacks and waiters."""
        if (state is LinkState.READY) != (self.state is LinkState.READY):
            self.since = time.time()
        self.state = state
        for waiter in self._ready_waiters:
            if state is LinkState.READY and not waiter.done():
                waiter.set_result(None)
            elif state is LinkState.STOPPED and not waiter.done():
                waiter.set_exception(self.not_connected())
        for callback in tuple(self._callbacks):
            call_logged(callback, state)

    def note_lost(self, cause: BaseException | None) -> None:
        """Enter WAITING if the link is ready.

        The last error becomes `cause`, or None if that is not a LinkError.
        """
        if self.state is LinkState.READY:
            self.last_error = cause if isinstance(cause, LinkError) else None
            self._enter(LinkState.WAITING)

    async def wait_ready(self, timeout: float) -> None:
        """Wait until the link is ready.

        Raises:
            NotConnectedError: the link was closed, or not ready within `timeout` seconds.
        """
        if self.state is LinkState.READY:
            return
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._ready_waiters.add(waiter)
        try:
            await run_with_timeout(timeout, waiter)
        except TimeoutError:
            raise self.not_connected() from None
        finally:
            self._ready_waiters.discard(waiter)

    def not_connected(self) -> NotConnectedError:
        """Return the error for a request while there is no link."""
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        error = self.last_error
        why = _LAST_ERROR(error=said_by(error)) if error else _NO_ATTEMPT()
        return NotConnectedError(_NOT_CONNECTED(address=self.config.address, since=since, why=why))

    async def _run(self) -> None:
        """Connect, and reconnect while this is the current task."""
        this_task = asyncio.current_task()
        if earlier := self._tasks - {this_task}:  # cancelled tasks that close their connection
            await asyncio.wait(earlier)
        self.last_error = None
        backoff = Backoff(self.config.backoff_min, self.config.backoff_max)
        while self._current is this_task:
            config = self.config
            self._enter(LinkState.CONNECTING)
            try:
                connection = await self._connect(config)
                if await self._serve(connection) >= config.stable_after:
                    backoff.reset()
            except LinkError as error:
                self._note_failure(error, f"cannot connect to {config.address}: {error}")
            except Exception as error:  # the loop must survive whatever a library raises
                _LOG.debug("the link to %s failed", config.address, exc_info=True)
                self._note_failure(HandshakeError(repr(error)), f"internal error: {error!r}")
            if self.state is not LinkState.WAITING:
                self._enter(LinkState.WAITING)
            await asyncio.sleep(backoff.next())

    async def _connect(self, config: LinkConfig) -> Connection:
        """Return a connection after its handshake.

        Raises:
            LinkError: no connection was opened, or its handshake failed.
        """
        transport = await open_link(config)
        codec = client_codec(config)
        connection = Connection(
            transport,
            codec,
            config,
            self._record,
            partial(self._subscriptions.put_push, codec),
        )
        self.connection = connection  # new subscriptions go to it; requests are refused until READY
        try:
            await self._handshake(connection)
        except BaseException as error:
            self.connection = None
            # any other error is the cancellation of this task, or a defect
            cause = error if isinstance(error, LinkError) else NotConnectedError("given up")
            await connection.close(cause)
            raise
        connection.reads_ahead = True  # the first RobotInfo has come, so nothing can overtake it
        return connection

    async def _handshake(self, connection: Connection) -> None:
        """Renew the subscriptions, request RobotInfo, and check that the expected robot answers.

        Pushes are held back until it is known which robot sends them.

        Raises:
            LinkError: the connection ended, or no answer arrived in time.
            HandshakeError: the answer is not a RobotInfo.
            OtherRobotError: another robot than the expected one answered.
        """
        subscriptions, expected = self._subscriptions, self._robot

        def put_snapshot(answer: Answer) -> None:
            """Deliver the pushes that were held back, then RobotInfo, unless another robot answers.

            Called as soon as the answer is read, so that RobotInfo precedes the pushes after it.
            """
            if not _identity_in(answer).differs_from(expected):
                subscriptions.put_snapshot(answer)

        subscriptions.hold()
        try:
            connection.subscribe(subscriptions.wanted, on=True)
            answer = await self._request_info(connection, put_snapshot)
            self._check_info(answer)
            robot = _identity_in(answer)
            if robot.differs_from(expected):
                raise OtherRobotError(_OTHER_ROBOT(robot=str(robot), expected=str(expected)))
            # `put_snapshot` has done so already, but not for a RobotInfo that cannot be read
            subscriptions.release()
            # the link becomes ready only now: whoever commands the robot must know its state
            delivered = asyncio.ensure_future(subscriptions.wait_delivered())
            try:
                await asyncio.wait(
                    (delivered, connection.ended), return_when=asyncio.FIRST_COMPLETED
                )
                if connection.ended.done():
                    raise connection.ended.result()
            finally:
                delivered.cancel()
            self._robot = robot.completed_by(expected)
        finally:
            subscriptions.discard_held()

    async def _request_info(self, connection: Connection, tap: Callable[[Answer], None]) -> Answer:
        """Request RobotInfo, and again while no answer comes, since a single frame may be lost.

        Raises:
            LinkError: no answer came within `handshake_timeout`, or the connection has ended.
        """
        remaining = self.config.handshake_timeout
        message = RobotInfo(robot_id=self.config.robot_id or None)
        requests: set[asyncio.Task[Answer]] = set()
        try:
            while True:
                request = connection.request(message, Sending(remaining, tap=tap))
                requests.add(asyncio.ensure_future(request))
                # yet another request would have at most `_RETRY_AFTER` left for its answer
                is_last = remaining <= 2 * _RETRY_AFTER
                done, _ = await asyncio.wait(
                    requests,
                    timeout=None if is_last else _RETRY_AFTER,  # each request has its own timeout
                    return_when=asyncio.FIRST_COMPLETED,
                )
                if done:
                    return done.pop().result()
                remaining -= _RETRY_AFTER
        except NotConnectedError:  # the connection ended before the request
            raise connection.ended.result() from None
        finally:
            await cancel_and_wait(*requests)

    def _check_info(self, answer: Answer) -> None:
        """Raise a HandshakeError if an answer is not a RobotInfo; warn if it cannot be read."""
        if not answer.ok:
            raise HandshakeError(_NO_INFO(reason=one_line(answer.msg) or REFUSED()))
        if answer.type != full_name(RobotInfo):
            raise HandshakeError(_NO_INFO(reason=one_line(answer.defect) or _OTHER_TYPE))
        if answer.defect:  # perhaps from newer firmware; everything else may work
            text = f"the first values are missing because {answer.defect}"
            self._log.warn("no snapshot", text)

    async def _serve(self, connection: Connection) -> float:
        """Keep the link ready until the connection ends; return the duration, in seconds."""
        loop = asyncio.get_running_loop()
        ready_at = loop.time()
        cause: LinkError = ConnectionLostError(_CLOSED())  # if this task is cancelled
        try:
            self.last_error = None
            self._log.clear()  # each link logs its problems again
            self._record.stats.connects += 1
            _LOG.info("connected to %s", self.config.address)
            self._enter(LinkState.READY)
            cause = await asyncio.shield(connection.ended)
            lasted = loop.time() - ready_at
            self._note_failure(cause, f"lost the link to {self.config.address}: {cause}")
        finally:
            self.connection = None
            self.note_lost(cause)  # first, because the close may take long
            await connection.close(cause)
        return lasted

    def _note_failure(self, error: LinkError, text: str) -> None:
        """Set the last error, and log `text`; as a warning only if the error is a new one."""
        self.last_error = error
        self._log.warn(f"connect: {type(error).__name__}: {error}", text)
