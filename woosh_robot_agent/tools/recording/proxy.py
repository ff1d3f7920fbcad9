"""A proxy that records the frames between clients and a chassis."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import LogOnce, system_text
from woosh_robot_agent.link.server import Listener
from woosh_robot_agent.link.tasks import (
    abort_transport,
    cancel_and_wait,
    drop_unsent_at_end,
    run_with_timeout,
)
from woosh_robot_agent.tools.recording.layout import Side
from woosh_robot_agent.tools.recording.streams import (
    DelimitedParser,
    Direction,
    FrameParser,
    FrameRecorder,
    WebSocketParser,
)
from woosh_robot_agent.tools.recording.writer import RecordingWriter

_BURST = 20
"""Number of reads that may follow each other without a delay after a pause."""
_LARGE = 16 * 1024
"""Size from which a read is large enough that the next one need not be delayed, in bytes."""


class ReadPace:
    """Delays reads of a stream so that frames that arrive at high rates are read together.

    Waking up for a frame costs several times as much CPU time as reading one more frame.

    Args:
        period: minimum average time between two reads, in seconds.
        now: returns the time, in seconds; by default the time of the event loop.
    """

    def __init__(
        self,
        transport: asyncio.BaseTransport,
        period: float,
        now: Callable[[], float] | None = None,
    ) -> None:
        assert isinstance(transport, asyncio.ReadTransport)
        self._transport = transport
        self._period = period
        self._now = now or asyncio.get_running_loop().time
        self._due = 0.0
        """Earliest time of the next read, by `now`; in the past if reads are rare."""

    async def wait(self, size: int) -> None:
        """Wait until the next read may follow; the previous one had `size` bytes."""
        if size >= _LARGE:
            return
        now = self._now()
        # reads that a pause left out may follow without a delay, but at most _BURST
        self._due = max(self._due, now - _BURST * self._period) + self._period
        if self._due > now:
            self._transport.pause_reading()
            await asyncio.sleep(self._due - now)
            self._transport.resume_reading()


_LOG = logging.getLogger(__name__)
_CHUNK_SIZE = 256 * 1024
"""Maximum size of a read, in bytes."""
_LINGER_TIMEOUT = 5.0
"""Time that one side gets to close the connection after the other side did, in seconds."""
READ_PERIOD = 0.005
"""Minimum average time between two reads while a client waits for the frames, in seconds."""
_FLUSH_PERIOD = 1.0
"""Time between two flushes of the file, in seconds."""


@dataclass
class _Connection:
    """Connection of one client, and the proxy's connection to the chassis for it.

    Attributes:
        number: number of the connection, from 1.
        writers: stream to the client, and after it the stream to the chassis once there is one.
        has_ended: True once the end of the connection has been recorded.
    """

    number: int
    writers: list[asyncio.StreamWriter] = field(default_factory=list)
    has_ended: bool = False


class RecordingProxy:
    """A proxy that records frames; bytes that it cannot parse are forwarded, too.

    For each client, it opens a connection of its own to the chassis.

    Args:
        chassis: address, transport, frame size limit and connect timeout of the chassis.
        read_period: minimum average time between two reads, in seconds. Frames that arrive at a
            higher rate are delayed by up to this time.
    """

    def __init__(
        self, chassis: LinkConfig, writer: RecordingWriter, read_period: float = READ_PERIOD
    ) -> None:
        self._chassis = chassis
        self._read_period = read_period
        self._writer = writer
        self._recorder = FrameRecorder(writer)
        self._log = LogOnce(_LOG)
        self._count = 0
        """Number of clients so far."""
        self._tasks: set[asyncio.Task[None]] = set()
        """The task that flushes, and one task for each client."""
        self._listener: Listener | None = None
        self._is_stopping = False

    async def start(self, host: str, port: int) -> int:
        """Listen for clients.

        Args:
            port: port to listen on; 0 for any free port.

        Returns:
            The port in use.

        Raises:
            OSError: the proxy cannot listen there, e.g. because the port is in use.
        """
        self._listener = Listener(await asyncio.start_server(self._serve, host, port))
        self._tasks.add(asyncio.get_running_loop().create_task(self._flush()))
        return self._listener.port

    async def stop(self) -> None:
        """Drop all clients, stop listening and record what has arrived; the writer stays open."""
        self._is_stopping = True
        await cancel_and_wait(*self._tasks)
        if self._listener is not None:
            await self._listener.close()
        self._recorder.close()

    async def _flush(self) -> None:
        while True:
            await asyncio.sleep(_FLUSH_PERIOD)
            self._recorder.call(self._writer.flush)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until its connection ends, and record the end."""
        if self._is_stopping:  # `stop` has cancelled the tasks of the other clients
            abort_transport(writer.transport)
            return
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        self._count += 1
        connection = _Connection(self._count, [writer])
        try:
            await self._forward(connection, reader, writer)
        except asyncio.CancelledError:  # by `stop`; asyncio's server must not see the error
            self._end(connection, "recorder", "the recording was stopped")
        except Exception as error:  # a bug here must not look like an error of the robot
            _LOG.exception("connection %d failed", connection.number)
            self._end(connection, "recorder", f"internal error: {error!r}")
        finally:
            for each in connection.writers:
                abort_transport(each.transport)
            self._tasks.discard(task)

    async def _forward(
        self,
        connection: _Connection,
        client_reader: asyncio.StreamReader,
        client_writer: asyncio.StreamWriter,
    ) -> None:
        """Connect to the chassis, and copy both directions until they end.

        When one direction has ended, the other one has `_LINGER_TIMEOUT` to end, too.
        """
        config = self._chassis
        peer = client_writer.get_extra_info("peername")
        try:
            opening = asyncio.open_connection(config.ip, config.effective_port)
            chassis_reader, chassis_writer = await run_with_timeout(config.connect_timeout, opening)
        except OSError as error:
            reason = system_text(error)
            if isinstance(error, TimeoutError) and not error.errno:  # not from the socket
                reason = f"no answer within {config.connect_timeout:g} s"
            self._recorder.add_event(connection.number, "refused", "chassis", reason)
            self._log.warn("refused", f"{config.address} cannot be reached: {reason}")
            return
        self._log.clear("refused")
        connection.writers.append(chassis_writer)
        self._recorder.add_event(connection.number, "open", "client", f"{peer[0]}:{peer[1]}")
        _LOG.info("connected to %s for client %d", config.address, connection.number)
        loop = asyncio.get_running_loop()
        directions = {
            loop.create_task(self._copy(connection, "client", client_reader, chassis_writer)),
            loop.create_task(self._copy(connection, "chassis", chassis_reader, client_writer)),
        }
        try:
            await asyncio.wait(directions, return_when=asyncio.FIRST_COMPLETED)
            await asyncio.wait(directions, timeout=_LINGER_TIMEOUT)
        finally:
            if not all(each.done() for each in directions):
                drop_unsent_at_end(chassis_writer.transport)  # a command must not arrive much later
            await cancel_and_wait(*directions)
        for direction in directions:
            if not direction.cancelled() and (bug := direction.exception()):
                raise bug

    async def _copy(
        self,
        connection: _Connection,
        sender: Side,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Copy from `reader` to `writer` until the end; forward each piece before recording it."""
        direction = Direction(
            connection.number,
            sender,
            self._make_parser(sender),
            partial(self._record_end, connection, sender),
        )
        receiver: Side = "chassis" if sender == "client" else "client"
        client_writer, chassis_writer = connection.writers
        # a reader does not give its transport, but the writer of the same connection does
        source = client_writer if sender == "client" else chassis_writer
        pace = ReadPace(source.transport, self._read_period)
        is_reading = True
        try:
            while data := await reader.read(_CHUNK_SIZE):
                writer.write(data)
                self._recorder.add(direction, data)
                is_reading = False
                await writer.drain()
                is_reading = True
                await pace.wait(len(data))
            self._end(connection, sender, "without a close frame")
            with contextlib.suppress(OSError):  # the receiver is gone, too
                writer.write_eof()
        except OSError as error:  # also a TimeoutError, if the other computer has vanished
            by = sender if is_reading else receiver  # the side whose socket failed
            self._end(connection, by, error.strerror or type(error).__name__)
            drop_unsent_at_end(writer.transport)  # the sender may have given up its commands
            abort_transport(writer.transport)

    def _end(self, connection: _Connection, by: Side, how: str) -> None:
        """Record in the recorder's thread that a connection has ended now."""
        self._recorder.call(self._record_end, connection, by, how, self._writer.now())

    def _record_end(self, connection: _Connection, by: Side, how: str, at: int) -> None:
        """Record the end of a connection; runs in the recorder's thread.

        Only the first end counts, which may be a close frame. The other side may end much later,
        when the client has connected again. A connection whose begin is not recorded has no end.
        """
        has_begun = len(connection.writers) == 2  # the chassis has been reached, too
        if has_begun and not connection.has_ended:
            connection.has_ended = True
            self._writer.add_event(connection.number, "close", by, how, at)

    def _make_parser(self, sender: Side) -> FrameParser:
        max_size = self._chassis.max_frame_size
        if self._chassis.transport == "tcp":
            return DelimitedParser(max_size)
        return WebSocketParser(masked=sender == "client", max_size=max_size)
