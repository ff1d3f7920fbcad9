"""Floor of `record`: a proxy that forwards every byte and looks at none.

    python -m benchmarks.floors.proxy PORT

It prints the port that it listens on, and forwards each connection to PORT on this machine.
"""

from __future__ import annotations

import asyncio
import sys

_CHUNK = 256 * 1024
"""Maximum number of bytes that are forwarded at a time."""


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(_CHUNK):
        writer.write(data)
        await writer.drain()
    writer.close()


async def main(port: int) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        robot_reader, robot_writer = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(_copy(reader, robot_writer), _copy(robot_reader, writer))

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
