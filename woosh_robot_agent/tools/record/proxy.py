"""Stands between clients and a chassis, passes every byte on untouched and records the frames."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from dataclasses import dataclass, field

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.timeouts import drop, within
from woosh_robot_agent.link.transports import Listener
from woosh_robot_agent.tools.recording import Side, Writer
from woosh_robot_agent.tools.wiretap import DelimitedEar, Ear, UnreadableError, WebSocketEar

_LOG = logging.getLogger(__name__)
_CHUNK = 256 * 1024
_LINGER = 5.0
"""s that one side gets to end what the other one has ended."""
_FLUSH_EVERY = 1.0


@dataclass
class _Connection:
    """One connection of a client, and ours to the chassis for it.

    Attributes:
        number: from 1.
        ended_by: who was the first to end it, and how.
    """

    number: int
    ended_by: tuple[Side, str] | None = None
    writers: list[asyncio.StreamWriter] = field(default_factory=list)


class Recorder:
    """A proxy that records. What it cannot read it passes on all the same.

    Args:
        chassis: the chassis; clients are connected to it one by one.
        writer: takes the frames.
    """

    def __init__(self, chassis: LinkConfig, writer: Writer) -> None:
        self._chassis = chassis
        self._writer = writer
        self._count = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._listener: Listener | None = None

    async def start(self, host: str, port: int) -> int:
        """Take clients; returns the port, which is a free one if `port` is 0.

        Raises:
            OSError: the port is taken.
        """
        self._listener = Listener(await asyncio.start_server(self._serve, host, port))
        self._tasks.add(asyncio.get_running_loop().create_task(self._flush()))
        return self._listener.port

    async def stop(self) -> None:
        """Drop everybody and listen no more; the writer stays open."""
        tasks = tuple(self._tasks)
        await drop(*tasks)
        if self._listener is not None:
            await self._listener.close()

    async def _flush(self) -> None:
        while True:
            await asyncio.sleep(_FLUSH_EVERY)
            self._writer.flush()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        self._count += 1
        connection = _Connection(self._count, writers=[writer])
        try:
            await self._pass_on(connection, reader, writer)
        except asyncio.CancelledError:  # by `stop`; the server must not see it
            self._ended(connection, "recorder", "the recording was ended")
        except Exception as error:  # a mistake of ours must not look like one of the robot
            _LOG.exception("connection %d failed", connection.number)
            self._ended(connection, "recorder", f"internal error: {error!r}")
        finally:
            for each in connection.writers:
                each.transport.abort()
            if connection.ended_by is not None:
                self._writer.event(connection.number, "close", *connection.ended_by)
            self._tasks.discard(task)

    async def _pass_on(
        self, connection: _Connection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        config = self._chassis
        peer = writer.get_extra_info("peername")
        try:
            opening = asyncio.open_connection(config.ip, config.effective_port)
            there, back = await within(config.connect_timeout, opening)
        except OSError as error:
            reason = error.strerror or str(error) or type(error).__name__
            self._writer.event(connection.number, "refused", "chassis", reason)
            _LOG.warning("a client came, but %s does not answer: %s", config.address, reason)
            return
        connection.writers.append(back)
        self._writer.event(connection.number, "open", "client", f"{peer[0]}:{peer[1]}")
        _LOG.info("client %d connected", connection.number)
        loop = asyncio.get_running_loop()
        pumps = {
            loop.create_task(self._pump(connection, "client", reader, back)),
            loop.create_task(self._pump(connection, "chassis", there, writer)),
        }
        try:
            await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
            await asyncio.wait(pumps, timeout=_LINGER)
        finally:
            await drop(*pumps)
        for pump in pumps:
            if not pump.cancelled() and (mistake := pump.exception()):
                raise mistake

    async def _pump(
        self,
        connection: _Connection,
        sender: Side,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Copy one direction to its end; what goes on first, and is looked at after that."""
        ear: Ear | None = self._ear(sender)
        other: Side = "chassis" if sender == "client" else "client"
        reading = True
        try:
            while data := await reader.read(_CHUNK):
                writer.write(data)
                ear = self._listen(connection, sender, ear, data)
                reading = False
                await writer.drain()
                reading = True
            self._ended(connection, sender, "without a close")
            with contextlib.suppress(OSError):  # the other side has gone too
                writer.write_eof()
        except ConnectionError as error:
            by = sender if reading else other
            self._ended(connection, by, error.strerror or type(error).__name__)
            writer.transport.abort()

    def _listen(
        self, connection: _Connection, sender: Side, ear: Ear | None, data: bytes
    ) -> Ear | None:
        if ear is None:
            return None
        try:
            for heard in ear.feed(data):
                if heard.close:
                    self._ended(connection, sender, heard.data.decode(errors="replace").strip())
                else:
                    self._writer.frame(connection.number, sender, heard.data, text=heard.text)
        except UnreadableError as error:
            self._writer.event(connection.number, "unreadable", sender, str(error))
            _LOG.warning("nothing more is recorded of what the %s sends: %s", sender, error)
            return None
        return ear

    def _ear(self, sender: Side) -> Ear:
        max_size = self._chassis.max_frame_size
        if self._chassis.transport == "tcp":
            return DelimitedEar(max_size)
        return WebSocketEar(masked=sender == "client", max_size=max_size)

    @staticmethod
    def _ended(connection: _Connection, by: Side, how: str) -> None:
        if connection.ended_by is None and len(connection.writers) == 2:
            connection.ended_by = by, how
