"""Recordings for tests: a writer, frames by number, and a proxy that records."""

from __future__ import annotations

import hashlib
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.tools.connections import link
from woosh_robot_agent.tools.recording.files import Limits
from woosh_robot_agent.tools.recording.proxy import RecordingProxy
from woosh_robot_agent.tools.recording.writer import RecordingWriter

HEAD = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"


def writer(path: Path, max_size: int = 2**28, on_early_end: Any = pytest.fail, **split: Any) -> Any:
    return RecordingWriter(path, "ws://robot:5480", Limits(max_size, **split), on_early_end)


def numbered(number: int) -> bytes:
    """Return a frame that compresses badly."""
    noise = hashlib.sha256(str(number).encode()).hexdigest()
    return json.dumps({"type": "test", "number": number, "noise": noise}).encode()


def add_numbered(file: RecordingWriter, count: int) -> None:
    """Write numbered frames of a client."""
    for number in range(count):
        file.add_frame(1, "client", numbered(number), text=True)


@asynccontextmanager
async def recording(
    path: Path, port: int, kind: str = "json", **options: Any
) -> AsyncIterator[int]:
    """Run a proxy that records every frame of a chassis; yield its port."""
    file = writer(path)
    proxy = RecordingProxy(link(port, kind), file, **options)
    try:
        yield await proxy.start("127.0.0.1", 0)
    finally:
        await proxy.stop()
        file.close()
    assert file.lost == 0
