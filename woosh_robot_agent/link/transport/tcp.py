"""TCP transport, in protobuf's delimited format: a varint length, then as many bytes."""

from __future__ import annotations

import asyncio
from typing import Any

from woosh_robot_agent.link.codecs.frames import FrameError
from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.link.transport.base import CHUNK, TransportClosedError, peer_address

_LARGEST_MESSAGE = 2**31 - 1
"""Size of the largest possible protobuf message, in bytes."""


class TcpTransport:
    """A TCP connection that carries delimited frames.

    Args:
        reader: the connection's stream reader.
        writer: the connection's stream writer.
        max_size: largest frame that is read, in bytes; larger ones are skipped.
    """

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, max_size: int
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._max_size = max_size
        self._now = asyncio.get_running_loop().time
        self.peer = peer_address(writer.transport)
        self.progress_at = 0.0
        self.received = 0
        self.waited = False

    def backlog(self) -> int:
        return self._writer.transport.get_write_buffer_size()

    async def send(self, data: str | bytes) -> None:
        frame = data.encode() if isinstance(data, str) else data
        await self._write(varint(len(frame)) + frame)

    async def recv(self) -> str | bytes:
        try:
            size = await self._read_varint()
            if size > _LARGEST_MESSAGE:  # skipping it would take forever
                raise TransportClosedError(f"not delimited protobuf: frame of {size} bytes")
            if size > self._max_size:
                await self._skip(size)
                raise FrameError(
                    "oversize", f"{size} bytes are more than max_frame_size, {self._max_size}"
                )
            if size <= CHUNK:
                self.received += size
                return await self._reader.readexactly(size)
            return await self._read_large(size)
        except asyncio.IncompleteReadError as error:
            where = "in the middle of a frame" if error.partial else "by the other end"
            raise TransportClosedError(f"closed {where}") from None
        except OSError as error:
            raise TransportClosedError(str(error) or type(error).__name__) from None

    async def ping(self) -> bool:
        return False

    async def close(self, timeout: float = 1.0) -> None:
        self._writer.close()
        try:
            await run_with_timeout(timeout, self._writer.wait_closed())
        except OSError:  # includes TimeoutError
            pass
        finally:
            self.abort()

    def abort(self) -> None:
        self._writer.transport.abort()

    async def _write(self, data: bytes) -> None:
        try:
            self._writer.write(data)
            await self._writer.drain()
        except (OSError, RuntimeError) as error:
            raise TransportClosedError(str(error) or type(error).__name__) from None

    async def _read_varint(self) -> int:
        size = 0
        for shift in range(0, 64, 7):
            byte = (await self._reader.readexactly(1))[0]
            size |= (byte & 0x7F) << shift
            if byte < 0x80:
                return size
        raise TransportClosedError("not delimited protobuf: the frame length is not a varint")

    async def _read_large(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            chunk = await self._reader.readexactly(min(size - len(data), CHUNK))
            data += chunk
            self.received += len(chunk)
            self.progress_at = self._now()
        return bytes(data)

    async def _skip(self, size: int) -> None:
        while size:
            size -= len(await self._reader.readexactly(min(size, CHUNK)))
            self.progress_at = self._now()


async def open_tcp(config: LinkConfig, made: list[Any]) -> TcpTransport:
    """Connect to a chassis by TCP.

    Args:
        config: address and limits.
        made: list to which the stream writer is added as soon as it exists, so that the caller can
            abort it.

    Raises:
        OSError: nothing answers at the address.
    """
    reader, writer = await asyncio.open_connection(config.ip, config.effective_port)
    made.append(writer)
    return TcpTransport(reader, writer, config.max_frame_size)


def varint(value: int) -> bytes:
    """Return a number as a protobuf varint: seven bits per byte, the least significant first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
