"""Frames that arrive at high rates: they are read and recorded together, without a delay."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from websockets.frames import Frame as WireFrame
from websockets.frames import Opcode

from tests.asynchronous import TIMEOUT
from tests.tools.recordings import HEAD, numbered, recording, writer
from woosh_robot_agent.tools.recording.files import Limits
from woosh_robot_agent.tools.recording.proxy import ReadPace
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_agent.tools.recording.streams import Direction, FrameRecorder, WebSocketParser
from woosh_robot_agent.tools.recording.writer import RecordingWriter

COUNT = 500
PERIOD = 0.005


def wire(data: bytes) -> bytes:
    """Return a text frame as a server sends it."""
    return WireFrame(Opcode.TEXT, data).serialize(mask=False)


def direction() -> Direction:
    return Direction(1, "chassis", WebSocketParser(masked=False, max_size=2**26), pytest.fail)


async def test_frames_of_a_flood_are_in_the_file_when_the_proxy_stops_at_once(tmp_path):
    sent = [wire(numbered(number)) for number in range(COUNT)]

    async def serve(reader: asyncio.StreamReader, flood: asyncio.StreamWriter) -> None:
        flood.write(HEAD)
        for frame in sent:
            flood.write(frame)
            await asyncio.sleep(0)  # so that it is sent as a piece of its own
        with contextlib.suppress(ConnectionResetError):  # by the end of the recording
            await reader.read()
        flood.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    path = tmp_path / "a.mcap"
    async with recording(path, server.sockets[0].getsockname()[1]) as port:
        reader, client = await asyncio.open_connection("127.0.0.1", port)
        expected = HEAD + b"".join(sent)
        assert await reader.readexactly(len(expected)) == expected
    client.close()
    server.close()
    opened, *frames, closed = read_recording(path).records
    assert opened.kind == "open"
    assert [json.loads(frame.data)["number"] for frame in frames] == [*range(COUNT)]
    assert (closed.kind, closed.by) == ("close", "recorder")


async def test_each_frame_has_the_time_at_which_it_arrived(tmp_path, monkeypatch):
    clock = [0]
    monkeypatch.setattr("time.clock_gettime_ns", lambda _: clock[0])
    file = writer(tmp_path / "a.mcap")
    recorder, chassis = FrameRecorder(file), direction()
    recorder.add(chassis, HEAD)
    first, second, third = (wire(numbered(number)) for number in range(3))
    clock[0] = 10**9
    recorder.add(chassis, first + second[:5])
    clock[0] = 2 * 10**9
    recorder.add(chassis, second[5:])
    clock[0] = 3 * 10**9
    recorder.add(chassis, third)
    clock[0] = 4 * 10**9
    recorder.add_event(1, "close", "chassis")
    recorder.close()
    file.close()
    found = read_recording(tmp_path / "a.mcap").records
    assert [record.t for record in found] == [1.0, 2.0, 3.0, 4.0]


class _HangingDisk(RecordingWriter):
    """A writer whose disk hangs until it is told to go on."""

    def __init__(self, path: Path, on_early_end: Callable[[str], None]) -> None:
        super().__init__(path, "ws://x", Limits(2**30), on_early_end)
        self.hangs, self.goes_on = threading.Event(), threading.Event()

    def flush(self) -> None:
        self.hangs.set()
        assert self.goes_on.wait(TIMEOUT)
        super().flush()


async def test_a_disk_that_hangs_delays_nobody_and_its_loss_is_told(tmp_path):
    ends: list[str] = []
    file = _HangingDisk(tmp_path / "a.mcap", ends.append)
    recorder, chassis = FrameRecorder(file), direction()
    recorder.add(chassis, HEAD)
    recorder.call(file.flush)
    assert await asyncio.to_thread(file.hangs.wait, TIMEOUT)
    frame = wire(b"x" * 1_500_000)
    for _ in range(40):  # each is handed over at once
        recorder.add(chassis, frame)
    assert (file.frames, ends) == (0, [])
    for _ in range(20):  # too much for the memory
        recorder.add(chassis, frame)
    recorder.call(file.flush)
    assert len(ends) == 1
    assert "a.mcap hangs or is too slow" in ends[0]
    file.goes_on.set()
    recorder.close()
    file.close()
    assert file.files.failed
    assert 40 <= file.frames < 60  # all that came until the end


async def test_reads_at_high_rates_are_delayed():
    server = await asyncio.start_server(lambda _, writer: writer.close(), "127.0.0.1", 0)
    _, stream = await asyncio.open_connection("127.0.0.1", server.sockets[0].getsockname()[1])
    transport = stream.transport
    clock = [100.0]
    pace = ReadPace(transport, PERIOD, now=lambda: clock[0])

    def free_reads(size: int, most: int) -> int:
        """Return the number of reads that follow each other at once."""
        for count in range(most):
            waiting = pace.wait(size)
            try:
                waiting.send(None)
            except StopIteration:
                continue
            waiting.close()
            transport.resume_reading()
            return count
        return most

    assert free_reads(100, 1000) == 20
    assert free_reads(100_000, 1000) == 1000  # large ones are not delayed
    assert free_reads(100, 1000) == 0
    clock[0] += 1.0
    assert free_reads(100, 1000) == 20
    clock[0] += 3 * PERIOD
    assert free_reads(100, 1000) == 2  # the read that was delayed counts
    assert transport.is_reading()
    waiting = asyncio.create_task(pace.wait(100))
    await asyncio.sleep(0)
    assert not transport.is_reading()
    await waiting
    assert transport.is_reading()
    stream.close()
    server.close()
