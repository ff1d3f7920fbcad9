"""Recording files, and the parsers that find frames in a byte stream."""

from __future__ import annotations

import io
import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import Writer
from websockets.frames import Frame as WireFrame
from websockets.frames import Opcode

from tests.tools import recordings
from tests.tools.recordings import HEAD, add_numbered, numbered
from woosh_robot_agent.tools.options import ToolError
from woosh_robot_agent.tools.recording.files import Limits, RecordingFiles
from woosh_robot_agent.tools.recording.layout import (
    FRAMES,
    ROS_PROFILE,
    Event,
    Frame,
    Recording,
)
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_agent.tools.recording.streams import (
    DelimitedParser,
    UnreadableError,
    WebSocketParser,
)
from woosh_robot_agent.tools.recording.writer import RecordingWriter

MIB = 2**20


def writer(path: Path, max_size: int = MIB, **split: Any) -> tuple[RecordingWriter, list[str]]:
    """Return a writer, and the reasons that it gives for an early end."""
    told: list[str] = []
    return recordings.writer(path, max_size, told.append, **split), told


def numbers(recording: Recording) -> list[int]:
    return [json.loads(each.data)["number"] for each in recording.records]


def test_a_recording_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "a.mcap"
    file, told = writer(path)
    file.add_event(1, "open", "client", "peer")
    file.add_frame(1, "client", '{"ü":"\\n"}'.encode(), text=True)
    file.add_frame(1, "chassis", b"\x00\xff", text=False)
    file.add_frame(1, "chassis", b"\xff{}", text=True)
    file.add_frame(2, "client", b"", text=True)
    file.add_frame(2, "client", b"", text=False)
    file.add_event(1, "close", "chassis")
    file.close()
    found = read_recording(path)
    assert (found.address, found.damage, told) == ("ws://robot:5480", "", [])
    assert (file.frames, file.lost, file.connections) == (5, 0, 1)
    times = [record.t for record in found.records]
    assert times == sorted(times)
    assert found.records == (
        Event(times[0], 1, "open", "client", "peer"),
        Frame(times[1], 1, "client", '{"ü":"\\n"}'),
        Frame(times[2], 1, "chassis", b"\x00\xff"),
        Frame(times[3], 1, "chassis", b"\xff{}", invalid=True),
        Frame(times[4], 2, "client", ""),
        Frame(times[5], 2, "client", b""),
        Event(times[6], 1, "close", "chassis"),
    )


def test_a_file_that_is_cut_off_anywhere_is_read_up_to_there(tmp_path):
    path, cut = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    file, _ = writer(path)
    flushed = []  # size of the file, and number of frames in it
    for number in range(200):
        file.add_frame(1, "client", numbered(number), text=True)
        if number % 20 == 19:
            file.flush()
            flushed.append((path.stat().st_size, number + 1))
    file.close()
    whole = path.read_bytes()
    for size in (*range(0, len(whole), 97), *range(len(whole) - 40, len(whole))):
        cut.write_bytes(whole[:size])
        least = max((count for end, count in flushed if end <= size), default=0)
        try:
            found = read_recording(cut)
        except ToolError:
            assert least == 0
            continue
        assert "has no end" in found.damage
        assert numbers(found) == list(range(len(found.records)))
        assert least <= len(found.records) <= least + 20
    assert read_recording(path).damage == ""


def test_a_damaged_file_is_read_up_to_the_damage(tmp_path):
    path = tmp_path / "a.mcap"
    file, _ = writer(path)
    ends = []
    for number in range(100):
        file.add_frame(1, "client", numbered(number), text=True)
        if number % 50 == 49:
            file.flush()
            ends.append(path.stat().st_size)
    file.close()
    data = bytearray(path.read_bytes())
    middle = sum(ends) // 2  # in the second chunk
    data[middle : middle + 4] = bytes(255 - byte for byte in data[middle : middle + 4])
    path.write_bytes(data)
    found = read_recording(path)
    assert "is damaged" in found.damage
    assert numbers(found) == list(range(50))


def test_a_chunk_that_expands_without_limit_is_damage(tmp_path):
    path = tmp_path / "a.mcap"
    file, _ = writer(path)
    file.add_frame(1, "client", numbered(0), text=True)
    file.flush()
    begin = path.read_bytes()
    compressed = zstandard.ZstdCompressor().compressobj(size=2**40)
    data = compressed.compress(bytes(MIB)) + compressed.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)
    for declared in (100, 2**40):
        chunk = RecordBuilder()
        Chunk("zstd", data, 0, 0, 0, declared).write(chunk)
        path.write_bytes(begin + chunk.end())
        found = read_recording(path)
        assert f"a chunk of {2**40} bytes is more than" in found.damage
        assert numbers(found) == [0]
    file.close()


def test_the_size_limit_ends_the_recording(tmp_path):
    path = tmp_path / "a.mcap"
    file, told = writer(path, max_size=50_000)
    add_numbered(file, 2000)
    assert len(told) == 1
    assert "size limit" in told[0]
    file.close()
    assert len(told) == 1
    found = read_recording(path)
    assert found.damage == ""
    assert 200 < len(found.records) == file.frames < 2000
    assert (file.frames + file.lost, file.files.failed) == (2000, True)
    assert 40_000 < path.stat().st_size < 70_000  # with the index


def test_a_recording_is_split_by_size(tmp_path):
    file, told = writer(tmp_path / "a.mcap", split_size=40_000)
    add_numbered(file, 2000)
    file.close()
    assert len(file.files.paths) > 2
    assert file.files.paths == [
        tmp_path / f"a_{index}.mcap" for index in range(len(file.files.paths))
    ]
    assert all(path.stat().st_size < 60_000 for path in file.files.paths)  # with the index
    assert (told, file.frames, file.lost) == ([], 2000, 0)
    found = read_recording(*reversed(file.files.paths))
    assert (numbers(found), found.damage) == (list(range(2000)), "")
    times = [record.t for record in found.records]
    assert times == sorted(times)
    # files that are not given are known
    assert found.missing_parts == ()
    assert read_recording(*file.files.paths[2:]).missing_parts == (0, 1)
    assert read_recording(*file.files.paths[:1], *file.files.paths[2:]).missing_parts == (1,)


def test_a_recording_is_split_by_time(tmp_path, monkeypatch):
    clock = [10**9]
    monkeypatch.setattr("time.clock_gettime_ns", lambda _: clock[0])
    file, _ = writer(tmp_path / "a.mcap", split_duration=5.0)
    for number in range(30):
        file.add_frame(1, "client", numbered(number), text=True)
        clock[0] += 10**9
    file.close()
    assert [len(read_recording(path).records) for path in file.files.paths] == [5] * 6
    assert [record.t for record in read_recording(*file.files.paths).records] == list(range(30))


def test_an_old_file_is_flushed_less_often(tmp_path, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    files = RecordingFiles(tmp_path / "a.mcap", Limits(MIB), lambda file: None, pytest.fail)
    written = set()
    for second in (*range(60), *range(86_400, 86_500)):
        clock[0] = second
        files.add(FRAMES, second, numbered(second))
        files.flush()
        written.add(files.count(FRAMES.topic))
    files.close()
    assert len(written) == 60 + 4  # after a day, every 25 s


def test_the_size_limit_counts_what_each_file_begins_with(tmp_path):
    told: list[str] = []
    files = RecordingFiles(
        tmp_path / "a.mcap",
        Limits(max_size=100_000, split_size=20_000),
        lambda file: file.attach("map.png", "image/png", bytes(40_000), 0),
        told.append,
    )
    for number in range(5000):
        files.add(FRAMES, number, numbered(number))
    files.close()
    assert len(told) == 1
    assert "size limit" in told[0]
    assert 1 < len(files.paths) < 4
    assert sorted(tmp_path.iterdir()) == files.paths


def test_files_of_ros_topics_are_left_out_and_alone_refused(tmp_path):
    file, _ = writer(tmp_path / "a.mcap", split_size=MIB)
    add_numbered(file, 1)
    file.close()
    ros = tmp_path / "a_ros_0.mcap"  # as `record --ros` writes it
    RecordingFiles(ros, Limits(MIB), lambda _: None, pytest.fail, ROS_PROFILE).close()
    found = read_recording(ros, *file.files.paths)
    assert (numbers(found), found.missing_parts) == ([0], ())
    with pytest.raises(ToolError, match=r"a_ros_0\.mcap has only ROS topics: play it with"):
        read_recording(ros)


def test_files_that_do_not_belong_together_are_refused(tmp_path):
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path in paths:
        writer(path)[0].close()
    with pytest.raises(ToolError, match="different recordings"):
        read_recording(*paths)
    with pytest.raises(ToolError, match="the same file: leave out one"):
        read_recording(paths[0], paths[0])


def mcap(version: str | None) -> bytes:
    """Return an MCAP file with no frames, and with a version of the layout."""
    file = io.BytesIO()
    other = Writer(file)
    other.start()
    if version:
        other.add_metadata("woosh_robot_agent", {"version": version})
    other.finish()
    return file.getvalue()


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "not a recording"),
        (b"hello, this is a text", "no MCAP file"),
        (b'{"format":"woosh_robot_agent recording","version":1}\n', "no MCAP file"),
        (mcap(None), "not a recording made with"),
        (mcap("9"), "has version 9"),
    ],
)
def test_a_file_that_is_no_recording_is_refused(tmp_path, content, text):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(ToolError, match=text):
        read_recording(path)


def parse(parser: Any, stream: bytes, chunk: int) -> list[Any]:
    """Return the frames in a stream that arrives in chunks."""
    pieces = (stream[begin : begin + chunk] for begin in range(0, len(stream), chunk))
    return [frame for piece in pieces for frame in parser.feed(piece)]


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
    parsed = parse(WebSocketParser(masked=masked, max_size=1000), stream, chunk)
    assert [(each.data, each.text, each.close) for each in parsed] == [
        (b"\xff\xfe", True, False),
        (b"hello", True, False),
        (b"\0" * 300, False, False),
        (b"code 1000 bye", False, True),
    ]


WEBSOCKET = partial(WebSocketParser, masked=False, max_size=1000)
DELIMITED = partial(DelimitedParser, 1000)


@pytest.mark.parametrize(
    ("make_parser", "stream"),
    [
        (WEBSOCKET, HEAD + b"\x7f\x00"),  # unknown opcode
        (WEBSOCKET, HEAD + WireFrame(Opcode.BINARY, b"\0" * 2000).serialize(mask=False)),
        (WEBSOCKET, HEAD + b"\xc1\x00"),  # compressed
        (WEBSOCKET, b"x" * 100_000),
        (DELIMITED, b"\xff" * 10),
        (DELIMITED, b"\xe9\x07" + b"x"),
    ],
)
def test_data_without_frames_is_an_error(make_parser, stream):
    with pytest.raises(UnreadableError):
        list(make_parser().feed(stream))


@pytest.mark.parametrize("chunk", [1, 3, 10_000])
def test_delimited_frames_are_found(chunk):
    stream = b"\x03abc" + b"\x00" + b"\xac\x02" + b"x" * 300
    parsed = parse(DelimitedParser(1000), stream, chunk)
    assert [each.data for each in parsed] == [b"abc", b"", b"x" * 300]
