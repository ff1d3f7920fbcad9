"""Recording files, and the parsers that find frames in a byte stream."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from websockets.frames import Frame as WireFrame
from websockets.frames import Opcode

from woosh_robot_agent.tools.record.frame_parsers import (
    DelimitedParser,
    UnreadableError,
    WebSocketParser,
)
from woosh_robot_agent.tools.recording.reader import RecordingError, read_recording
from woosh_robot_agent.tools.recording.records import Event, Frame
from woosh_robot_agent.tools.recording.writer import RecordingWriter

HEAD = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"
MIB = 2**20


def writer(path: Path, max_size: int = MIB) -> tuple[RecordingWriter, list[str]]:
    told: list[str] = []
    return RecordingWriter(path, "ws://x:5480", max_size, told.append), told


@pytest.mark.parametrize("name", ["a.jsonl", "a.jsonl.gz"])
def test_a_recording_is_read_as_it_was_written(tmp_path, name):
    path = tmp_path / name
    file, told = writer(path)
    file.event(1, "open", "client", "peer")
    file.frame(1, "client", '{"ü":"\\n"}'.encode(), text=True)
    file.frame(1, "chassis", b"\x00\xff", text=False)
    file.frame(1, "chassis", b"\xff{}", text=True)
    file.event(1, "close", "chassis")
    file.close()
    found = read_recording(path)
    assert (found.address, found.damage, told) == ("ws://x:5480", "", [])
    assert (file.frames, file.connections) == (3, 1)
    times = [record.t for record in found.records]
    assert times == sorted(times)
    opened, text, binary, invalid, closed = found.records
    assert opened == Event(times[0], 1, "open", "client", "peer")
    assert text == Frame(times[1], 1, "client", '{"ü":"\\n"}')
    assert binary == Frame(times[2], 1, "chassis", b"\x00\xff")
    assert invalid == Frame(times[3], 1, "chassis", b"\xff{}", invalid=True)
    assert closed == Event(times[4], 1, "close", "chassis")


@pytest.mark.parametrize("name", ["a.jsonl", "a.jsonl.gz"])
def test_a_crash_loses_only_the_end(tmp_path, name):
    path = tmp_path / name
    file, _ = writer(path)
    for number in range(100):
        file.frame(1, "client", str(number).encode(), text=True)
    file.flush()
    whole = path.read_bytes()  # as after a crash, because the file is not closed
    assert [record.data for record in read_recording(path).records] == [str(n) for n in range(100)]
    file.close()
    path.write_bytes(whole[:-7])
    found = read_recording(path)
    assert found.damage
    assert 0 < len(found.records) <= 100
    assert [record.data for record in found.records] == [
        str(number) for number in range(len(found.records))
    ]


def test_an_existing_file_is_not_overwritten(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        writer(path)
    assert path.read_text() == "mine"


def test_the_size_limit_ends_the_recording(tmp_path):
    file, told = writer(tmp_path / "a.jsonl", max_size=400)
    for _ in range(50):
        file.frame(1, "client", b"0123456789", text=True)
    assert len(told) == 1
    assert "size limit" in told[0]
    found = read_recording(file.path)
    assert 0 < len(found.records) == file.frames < 50
    assert file.path.stat().st_size <= 400
    file.close()
    assert len(told) == 1


def test_a_full_disk_ends_the_recording(tmp_path):
    file, told = writer(tmp_path / "a.jsonl")
    file.frame(1, "client", b"x", text=True)
    with open("/dev/full", "wb") as full:
        os.dup2(full.fileno(), file._raw.fileno())
    for _ in range(3):
        file.frame(1, "client", b"x", text=True)
    assert len(told) == 1
    assert "No space left" in told[0]
    file.close()


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "no header"),
        (b"hello\n", "line 1 is not JSON"),
        (b'{"a":1}\n', "not a header"),
        (b"[]\n", "not a JSON object"),
        (b'{"format":"woosh_robot_agent recording","version":9}\n', "version 9"),
        (b'{"format":"woosh_robot_agent recording","version":1}\n{"t":1}\n', "line 2"),
        (
            b'{"format":"woosh_robot_agent recording","version":1}\n'
            b'{"t":1,"connection":1,"from":"dog","text":""}\n',
            "unknown side 'dog'",
        ),
    ],
)
def test_a_file_that_is_no_recording_is_refused(tmp_path, content, text):
    path = tmp_path / "a.jsonl"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=text):
        read_recording(path)


def test_a_file_that_is_not_gzip_is_refused(tmp_path):
    path = tmp_path / "a.jsonl.gz"
    path.write_bytes(json.dumps({}).encode())
    with pytest.raises(RecordingError, match="not a gzip"):
        read_recording(path)


@pytest.mark.parametrize("chunk", [1, 7, 10_000])
@pytest.mark.parametrize("masked", [False, True])
def test_websocket_frames_are_found(masked, chunk):
    frames = [
        WireFrame(Opcode.TEXT, b"\xff\xfe"),  # invalid UTF-8, but a frame
        WireFrame(Opcode.TEXT, b"he", fin=False),
        WireFrame(Opcode.PING, b"x"),
        WireFrame(Opcode.CONT, b"llo"),
        WireFrame(Opcode.BINARY, b"\0" * 300),
        WireFrame(Opcode.CLOSE, b"\x03\xe8bye"),
    ]
    stream = HEAD + b"".join(frame.serialize(mask=masked) for frame in frames)
    parser = WebSocketParser(masked=masked, max_size=1000)
    parsed = [
        each
        for begin in range(0, len(stream), chunk)
        for each in parser.feed(stream[begin : begin + chunk])
    ]
    assert [(each.data, each.text, each.close) for each in parsed] == [
        (b"\xff\xfe", True, False),
        (b"hello", True, False),
        (b"\0" * 300, False, False),
        (b"code 1000 bye", False, True),
    ]


@pytest.mark.parametrize(
    "stream",
    [
        HEAD + b"\x7f\x00",  # unknown opcode
        HEAD + WireFrame(Opcode.BINARY, b"\0" * 2000).serialize(mask=False),
        HEAD + b"\xc1\x00",  # compressed
        b"x" * 100_000,
    ],
)
def test_data_that_is_no_websocket_is_an_error(stream):
    with pytest.raises(UnreadableError):
        list(WebSocketParser(masked=False, max_size=1000).feed(stream))


@pytest.mark.parametrize("chunk", [1, 3, 10_000])
def test_delimited_frames_are_found(chunk):
    stream = b"\x03abc" + b"\x00" + b"\xac\x02" + b"x" * 300
    parser = DelimitedParser(1000)
    parsed = [
        each.data
        for begin in range(0, len(stream), chunk)
        for each in parser.feed(stream[begin : begin + chunk])
    ]
    assert parsed == [b"abc", b"", b"x" * 300]


@pytest.mark.parametrize("stream", [b"\xff" * 10, b"\xe9\x07" + b"x"])
def test_data_that_is_not_delimited_is_an_error(stream):
    with pytest.raises(UnreadableError):
        list(DelimitedParser(1000).feed(stream))
