"""Serving TCP clients."""

from __future__ import annotations

import asyncio
from typing import Any

from woosh_robot_agent.link.server.base import Handler
from woosh_robot_agent.link.server.listener import Listener
from woosh_robot_agent.link.transport.tcp import TcpTransport, varint


class TcpServerTransport(TcpTransport):
    """The server's end of a TCP connection."""

    def header(self, size: int, *, text: bool = False) -> bytes:
        return varint(size)

    async def send_raw(self, data: bytes) -> None:
        await self._write(data)

    def pause(self) -> None:
        self._read_side.pause_reading()

    def resume(self) -> None:
        self._read_side.resume_reading()

    @property
    def _read_side(self) -> Any:
        return self._writer.transport  # one object for both directions


async def serve_tcp(handler: Handler, host: str, port: int, *, max_size: int) -> Listener:
    """Listen for TCP clients.

    Args:
        handler: serves one connection.
        host: the address to listen on.
        port: the port to listen on; 0 takes a free one.
        max_size: largest frame that is read, in bytes.
    """

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await handler(TcpServerTransport(reader, writer, max_size))

    return Listener(await asyncio.start_server(handle, host, port))
