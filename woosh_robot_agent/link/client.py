"""The client of a chassis: keeps a link to it alive, and is the only one that retries."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable, Coroutine, Iterable
from dataclasses import replace
from enum import Enum
from functools import partial
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.backoff import Backoff
from woosh_robot_agent.link.body import Body
from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.connection import Answer, Connection
from woosh_robot_agent.link.drop_log import Losses
from woosh_robot_agent.link.errors import (
    ConnectionLostError,
    HandshakeError,
    LinkError,
    NotConnectedError,
)
from woosh_robot_agent.link.log_once import LogOnce, shown
from woosh_robot_agent.link.stats import LinkStats
from woosh_robot_agent.link.subscriptions import Subscriptions, call
from woosh_robot_agent.link.timeouts import drop, within
from woosh_robot_agent.link.transports import TransportClosedError, open_transport
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name, message_types

_LOG = logging.getLogger(__name__)
_RUNNER = "link to the chassis"
_DEFAULTS = LinkConfig()
_ASK_AGAIN = 1.0
"""s without an answer after which a new link asks for RobotInfo once more."""
_CHANGEABLE = (
    "request_timeout",
    "connect_timeout",
    "handshake_timeout",
    "close_timeout",
    "stable_after",
    "max_in_flight",
    "push_queue",
)
M = TypeVar("M", bound=Message)


class LinkState(Enum):
    """Where the link stands."""

    STOPPED = "stopped"
    CONNECTING = "connecting"
    READY = "ready"
    WAITING = "waiting"


class ChassisClient:
    """A link to one chassis that comes back by itself.

    Use it in one asyncio event loop::

        async with ChassisClient("172.20.8.74") as chassis:
            chassis.subscribe(PoseSpeed, lambda pose_speed: print(pose_speed.pose))
            answer = await chassis.request(Speak(text="hello"))
            print(answer.ok, answer.msg)

    Nothing that was asked of it is repeated after a reconnect; subscriptions are renewed.

    Args:
        ip: address of the chassis; None takes the configuration's.
        config: timeouts and limits.
    """

    def __init__(self, ip: str | None = None, config: LinkConfig | None = None) -> None:
        base = config or LinkConfig()
        self._config = base if ip is None else replace(base, ip=ip)
        self.stats = LinkStats()
        self.state = LinkState.STOPPED
        self.since = time.time()
        """Unix time in s since which the link is ready, or is not."""
        self.last_error: LinkError | None = None
        self._log = LogOnce(_LOG)
        self._losses = Losses(_LOG)
        self._subscriptions = Subscriptions(
            self._config.push_queue, self.stats, self._log, self._losses
        )
        self._state_callbacks: list[Callable[[LinkState], None]] = []
        self._accepted_callbacks: dict[str, list[Callable[[], None]]] = {}
        self._connection: Connection | None = None
        self._reserved: Callable[[Message], bool] = _none
        """Selects the requests that only the caller of `reserve` may send."""
        self._runner: asyncio.Task[None] | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._ready_waiters: set[asyncio.Future[None]] = set()

    @property
    def config(self) -> LinkConfig:
        """The configuration in force."""
        return self._config

    # Life

    async def __aenter__(self) -> ChassisClient:
        """Start, and wait until the chassis is there.

        Raises:
            NotConnectedError: it is not there in time.
        """
        self.start()
        limit = self._config.connect_timeout + self._config.handshake_timeout
        try:
            await self.wait_ready(limit)
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.close()

    def start(self) -> None:
        """Begin to connect, and go on until closed. Must be called in the event loop."""
        if self._runner is not None:
            return
        self._runner = self._spawn(self._run(), _RUNNER)
        self._spawn(self._subscriptions.dispatch(), "link pushes")

    async def close(self) -> None:
        """Stop connecting and close the link, within the configured bound."""
        self._runner = None
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)
        self._losses.finish()
        if self._runner is None and self.state is not LinkState.STOPPED:
            self._enter(LinkState.STOPPED)

    def _spawn(self, work: Coroutine[Any, Any, None], name: str) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def wait_ready(self, timeout: float) -> None:
        """Wait until the link is ready.

        Raises:
            NotConnectedError: it is not within `timeout` s, or was closed; the text says why.
        """
        if self.state is LinkState.READY:
            return
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._ready_waiters.add(waiter)
        try:
            await within(timeout, waiter)
        except TimeoutError:
            raise self._not_connected() from None
        finally:
            self._ready_waiters.discard(waiter)

    async def reconfigure(self, config: LinkConfig) -> None:
        """Take a new configuration; the link is made anew where that is what it takes."""
        before, self._config = self._config, config
        self._subscriptions.set_depth(config.push_queue)
        if self._connection is not None:
            self._connection.config = config
        if self._runner is not None and _fixed_part(config) != _fixed_part(before):
            running = tuple(self._tasks)
            self._runner.cancel()
            self._runner = self._spawn(self._run(), _RUNNER)
            await self._ended(running)

    async def _ended(self, tasks: Iterable[asyncio.Task[None]]) -> None:
        """Wait for those that were connecting before; there is never more than one link."""
        runners = {task for task in tasks if task.get_name() == _RUNNER}
        if runners:
            await asyncio.wait(runners)

    # Use

    async def request(
        self,
        message: Message,
        timeout: float | None = None,
        *,
        first: bool = False,
        urgent: bool = False,
        send_within: float = math.inf,
        tap: Callable[[Answer], None] | None = None,
    ) -> Answer:
        """Send a request and wait for the answer; a refusal is an answer too, with `ok` False.

        Each call sends its own request. To drive the robot with velocities (woosh.robot.Twist), use
        `woosh_robot_agent.motion.MotionGate` around the client: it sends only the newest one while
        the chassis does not answer.

        Args:
            message: the request.
            timeout: time to wait for the answer, in seconds; by default the configured
                `request_timeout`.
            first: send it before all other requests that wait to be sent, as an urgent one.
            urgent: send it even if `max_in_flight` requests wait for answers already.
            send_within: maximum time that the request may wait to be sent, in seconds.
            tap: called with the answer in its place among the pushes: those pushed before it have
                been delivered, those pushed after it have not.

        Raises:
            NotConnectedError: there is no link; nothing was sent.
            TooManyRequestsError: nothing was sent.
            SupersededError: the request was withdrawn or waited too long; it was not sent.
            RequestTimeoutError: no answer in time.
            ConnectionLostError: the link went down before the answer.
            RuntimeError: the request is reserved; see `reserve`.
        """
        if self._reserved(message):
            raise RuntimeError(
                f"{full_name(message)} is reserved; send it through the object that reserved it"
            )
        return await self._request(
            message, timeout, first=first, urgent=urgent, send_within=send_within, tap=tap
        )

    def reserve(
        self, which: Callable[[Message], bool]
    ) -> Callable[..., Coroutine[Any, Any, Answer]]:
        """Reserve a part of the requests for the caller: `request` sends them no more.

        Args:
            which: selects the requests.

        Returns:
            A function that sends them; it takes the arguments of `request`.

        Raises:
            RuntimeError: requests of this client are reserved already.
        """
        if self._reserved is not _none:
            raise RuntimeError("requests of this client are reserved already")
        self._reserved = which
        return self._request

    def withdraw(self, which: Callable[[Message], bool], reason: str) -> None:
        """Withdraw requests that wait to be sent; those that were sent are not affected.

        The caller of a withdrawn request gets a SupersededError.

        Args:
            which: selects the requests.
            reason: the text of the error, after "not sent: ".
        """
        if self._connection is not None:
            self._connection.withdraw(which, reason)

    def subscribe(self, cls: type[M], callback: Callable[[M], None]) -> Callable[[], None]:
        """Have `callback` called with each push of `cls`, in the event loop; it must not block.

        Returns:
            A function that ends the subscription.

        Raises:
            ValueError: the chassis has no such message.
        """
        return self.subscribe_raw(cls, lambda body: callback(body.message()))

    def subscribe_raw(
        self, cls: type[Message], callback: Callable[[Body], None]
    ) -> Callable[[], None]:
        """As `subscribe`, but the pushes come as they are.

        Where `callback` raises the FrameError of a body that it reads, nobody else gets that push.

        Returns:
            A function that ends the subscription.

        Raises:
            ValueError: the chassis has no such message.
        """
        name = full_name(cls)
        if name not in message_types():
            raise ValueError(f"{name} is no message of the chassis")
        if self._subscriptions.add(name, callback) and self._connection is not None:
            self._connection.subscribe([name], on=True)
        over = False

        def unsubscribe() -> None:
            nonlocal over
            if over:
                return
            over = True
            if self._subscriptions.remove(name, callback) and self._connection is not None:
                self._connection.subscribe([name], on=False)

        return unsubscribe

    def on_state(self, callback: Callable[[LinkState], None]) -> None:
        """Have `callback` called in the event loop whenever the link's state has changed."""
        self._state_callbacks.append(callback)

    def on_snapshot(self, callback: Callable[[RobotInfo], None]) -> None:
        """Have `callback` called in the event loop with the RobotInfo of each new link.

        It comes in its place among the pushes: those before it are older, those after it newer.
        """
        self._subscriptions.on_snapshot(callback)

    def on_accepted(self, cls: type[Message], callback: Callable[[], None]) -> None:
        """Have `callback` called in the event loop when the chassis accepted a request of `cls`.

        It is called in its place among the pushes, as `tap` of `request` is.
        """
        self._accepted_callbacks.setdefault(full_name(cls), []).append(callback)

    def _tapped(
        self, message: Message, tap: Callable[[Answer], None] | None
    ) -> Callable[[Answer], None] | None:
        """What is to be called with the answer, in its place among the pushes."""
        callbacks = self._accepted_callbacks.get(full_name(message))
        if not callbacks:
            return None if tap is None else partial(self._subscriptions.answered, tap)

        def told(answer: Answer) -> None:
            for callback in callbacks if answer.ok else ():
                callback()
            if tap is not None:
                tap(answer)

        return partial(self._subscriptions.answered, told)

    async def _request(
        self,
        message: Message,
        timeout: float | None = None,
        *,
        first: bool = False,
        urgent: bool = False,
        send_within: float = math.inf,
        tap: Callable[[Answer], None] | None = None,
    ) -> Answer:
        if self._connection is None or self.state is not LinkState.READY:
            raise self._not_connected()
        try:
            return await self._connection.request(
                message,
                timeout,
                urgent=urgent or first,
                first=first,
                fresh=send_within,
                tap=self._tapped(message, tap),
            )
        except NotConnectedError as error:  # it has ended this moment
            self._down(error.__cause__)
            raise self._not_connected() from None

    def _not_connected(self) -> NotConnectedError:
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        why = f"last error: {self.last_error}" if self.last_error else "no attempt has ended yet"
        return NotConnectedError(
            f"not connected to {self._config.address} since {since} ({why}); check that the robot "
            "is on, that `ip` and `port` are right, and that the network reaches it"
        )

    # The loop that connects

    async def _run(self) -> None:
        me = asyncio.current_task()
        await self._ended(self._tasks - {me})
        config = self._config
        self.last_error = None
        backoff = Backoff(config.backoff_min, config.backoff_max)
        while self._runner is me:
            config = self._config
            self._enter(LinkState.CONNECTING)
            try:
                connection = await self._connect(config)
                if await self._serve(connection) >= config.stable_after:
                    backoff.reset()
            except LinkError as error:
                self._tell_failure(error, f"cannot connect to {config.address}: {error}")
            except Exception as error:  # whatever a library raises, the loop goes on
                _LOG.debug("the link to %s failed", config.address, exc_info=True)
                self._tell_failure(HandshakeError(repr(error)), f"internal error: {error!r}")
            if self.state is not LinkState.WAITING:
                self._enter(LinkState.WAITING)
            await asyncio.sleep(backoff.next())

    async def _connect(self, config: LinkConfig) -> Connection:
        """Open, subscribe and ask for RobotInfo; the answer makes the link ready."""
        try:
            transport = await open_transport(config)
        except OSError as error:
            raise NotConnectedError(error.strerror or str(error) or type(error).__name__) from None
        except TransportClosedError as error:
            raise HandshakeError(str(error)) from None
        codec: Codec = (
            JsonCodec()
            if config.transport == "websocket" and config.encoding == "json"
            else ProtobufCodec()
        )
        connection = Connection(
            transport,
            codec,
            config,
            self.stats,
            self._log,
            self._losses,
            partial(self._subscriptions.pushed, codec),
        )
        self._connection = connection  # subscriptions go to it; requests wait for READY
        try:
            connection.subscribe(self._subscriptions.wanted, on=True)
            answer = await self._ask_for_info(connection, config)
            if not answer.ok or answer.type != full_name(RobotInfo):
                reason = answer.msg if not answer.ok else answer.defect or "another type of answer"
                raise HandshakeError(f"the chassis did not give its RobotInfo: {shown(reason)}")
            if answer.defect:  # of newer firmware, perhaps: no reason to refuse all the rest
                self._log.warn("no snapshot", f"there are no first values: {answer.defect}")
        except BaseException as error:
            self._connection = None
            cause = error if isinstance(error, LinkError) else NotConnectedError("given up")
            await connection.close(cause)
            raise
        return connection

    async def _ask_for_info(self, connection: Connection, config: LinkConfig) -> Answer:
        """Ask for RobotInfo, and again while no answer comes: one that is lost costs little."""
        left = config.handshake_timeout
        ask = RobotInfo(robot_id=config.robot_id or None)
        asking: set[asyncio.Task[Answer]] = set()
        try:
            while True:
                request = connection.request(ask, left, tap=self._subscriptions.snapshot)
                asking.add(asyncio.ensure_future(request))
                done, _ = await asyncio.wait(
                    asking,
                    timeout=_ASK_AGAIN if left > 2 * _ASK_AGAIN else None,
                    return_when=asyncio.FIRST_COMPLETED,
                )
                if done:
                    return done.pop().result()
                left -= _ASK_AGAIN
        except NotConnectedError:  # it has ended before it was asked
            raise connection.ended.result() from None
        finally:
            await drop(*asking)

    async def _serve(self, connection: Connection) -> float:
        """Be ready until the connection ends; returns for how long it was."""
        loop = asyncio.get_running_loop()
        ready_at = loop.time()
        cause: LinkError = ConnectionLostError("the link was closed")
        try:
            self.last_error = None
            self._log.clear()
            self.stats.connects += 1
            self._enter(LinkState.READY)
            cause = await asyncio.shield(connection.ended)
            lasted = loop.time() - ready_at
            self._tell_failure(cause, f"lost the link to {self._config.address}: {cause}")
        finally:
            self._connection = None
            self._down(cause)  # before the close, which may take its time
            await connection.close(cause)
        return lasted

    def _down(self, cause: BaseException | None) -> None:
        if self.state is LinkState.READY:
            self.last_error = cause if isinstance(cause, LinkError) else None
            self._enter(LinkState.WAITING)

    def _tell_failure(self, error: LinkError, text: str) -> None:
        self.last_error = error
        self._log.warn(f"connect: {type(error).__name__}: {error}", text)

    def _enter(self, state: LinkState) -> None:
        if (state is LinkState.READY) != (self.state is LinkState.READY):
            self.since = time.time()
        self.state = state
        if state is LinkState.READY:
            _LOG.info("connected to %s", self._config.address)
        for waiter in self._ready_waiters:
            if state is LinkState.READY and not waiter.done():
                waiter.set_result(None)
            elif state is LinkState.STOPPED and not waiter.done():
                waiter.set_exception(self._not_connected())
        for callback in tuple(self._state_callbacks):
            call(callback, state)


def _none(_message: Message) -> bool:
    """Reserve nothing."""
    return False


def _fixed_part(config: LinkConfig) -> LinkConfig:
    """A configuration without what can change while the link stays."""
    return replace(config, **{name: getattr(_DEFAULTS, name) for name in _CHANGEABLE})
