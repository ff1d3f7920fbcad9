"""Connections to a chassis, a recording proxy or a replay, and a server of any protocol."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, Mode, TaskProc

KINDS = ["json", "protobuf", "tcp"]
Client = tuple[ChassisClient, list[Any]]
Connection = socketserver.StreamRequestHandler


def link(port: int, kind: str = "json", **more: Any) -> LinkConfig:
    if kind == "tcp":
        more |= {"transport": "tcp"}
    else:
        more |= {"encoding": kind}
    return LinkConfig(ip="127.0.0.1", port=port, backoff_min=0.05, backoff_max=0.1, **more)


@asynccontextmanager
async def connected(port: int, kind: str = "json", **more: Any) -> AsyncIterator[Client]:
    """Connect a client; yield it and the list of pushes that it receives."""
    client, pushes = ChassisClient(config=link(port, kind, **more)), []
    for cls in (TaskProc, Mode, Battery):
        client.subscribe(cls, pushes.append)
    async with client:
        yield client, pushes


@contextmanager
def serving(handle: Callable[[Connection], object]) -> Iterator[int]:
    """Call a function with each connection to a port, in a thread; yield the port."""
    handler = type("Handler", (Connection,), {"handle": handle})
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()
            thread.join()
