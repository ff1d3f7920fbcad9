"""A hostile chassis: the link's memory and time stay bounded, and the link keeps working."""

from __future__ import annotations

import logging
import sys
from dataclasses import replace
from typing import Any

import pytest

from tests.link.link_peer import (
    TIMEOUT,
    Peer,
    RawServer,
    answered,
    ask,
    error_of,
    eventually,
    linked,
    soon,
    varint,
)
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.link.codecs.json_codec import JsonCodec, from_json
from woosh_robot_agent.link.frames import FieldError, FrameError
from woosh_robot_agent.link.reports import LogOnce, PrintableFormatter
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed

MIB = 1024 * 1024


async def test_redirects_are_not_followed() -> None:
    """A redirect could connect the agent to another machine."""
    async with Peer() as elsewhere:

        async def redirect(reader: Any, writer: Any) -> None:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(
                b"HTTP/1.1 302 Found\r\nContent-Length: 0\r\n"
                + f"Location: ws://127.0.0.1:{elsewhere.port}\r\n\r\n".encode()
            )
            await reader.read()

        async with RawServer(redirect) as server:
            client = ChassisClient(config=replace(elsewhere.config(), port=server.port))
            assert "not a WebSocket server" in str(await error_of(client))
            assert not elsewhere.wires


async def test_an_impossible_length_ends_the_connection_at_once() -> None:
    """Skipping such a frame would never end, and its bytes would count as signs of life."""
    async with linked("tcp") as (peer, client, wire):
        await wire.raw(varint(2**40) + b"x" * 1000)
        await peer.wire(2)
        await client.wait_ready(TIMEOUT)


@pytest.mark.parametrize(
    "data",
    [
        "[" + "{}," * (1_500_000) + "{}]",
        '{"type":"woosh.robot.NavPath","body":{"path":{"poses":[' + "{}," * 1_500_000 + "{}]}}}",
        '{"type":"x","body":[' + "[]," * 1_500_000 + "[]]}",
        '{"type":"x","body":{' + '"n":1,' * 1_500_000 + '"n":1}}',
    ],
    ids=["envelope", "poses", "lists", "names"],
)
def test_the_parts_of_a_json_frame_are_limited(data: str) -> None:
    """An empty object is two bytes in a frame, but a hundred bytes in memory.

    The last byte is missing: a codec that parsed the frame first would report that it is not JSON.
    """
    with pytest.raises(FrameError, match="objects, lists and names"):
        JsonCodec().decode(data[:-1])


def test_a_large_frame_with_few_parts_is_read() -> None:
    numbers = ",".join(["0.25"] * 1_000_000)
    frame = JsonCodec().decode('{"type":"x","body":{"ranges":[' + numbers + "]}}")
    assert isinstance(frame.body, dict)


def test_numbers_as_text_are_limited_though_the_interpreter_does_not_limit_them() -> None:
    """Python needs many seconds to read a million digits."""
    limit = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)
    try:
        for text in ("9" * 20_000_000, "-" + "0" * 20_000_000, "9" * 4000):
            with pytest.raises(FieldError, match="too long"):
                from_json({"mapId": text}, PoseSpeed())
    finally:
        sys.set_int_max_str_digits(limit)


@pytest.fixture
def log(caplog: pytest.LogCaptureFixture) -> LogOnce:
    caplog.set_level(logging.DEBUG, "woosh_robot_agent.test")
    return LogOnce(logging.getLogger("woosh_robot_agent.test"))


def test_only_the_latest_kinds_are_remembered_by_their_beginning(
    log: LogOnce, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(300):
        log.warn(f"error {number}", "a problem")
    log.warn("error 299", "a remembered kind")
    log.warn("error 0", "a forgotten kind")
    log.warn("x" * 1000 + "one end", "a long kind")
    log.warn("x" * 1000 + "another end", "its other end")
    levels = {record.message: record.levelno for record in caplog.records}
    assert levels["a remembered kind"] == levels["its other end"] == logging.DEBUG
    assert levels["a forgotten kind"] == levels["a long kind"] == logging.WARNING


def test_a_problem_is_logged_again_once_it_has_not_occurred_for_a_while(
    log: LogOnce, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    for pause in (0.0, 599.0, 599.0, 601.0):
        now += pause
        log.warn("kind", f"after {pause:g} s")
    levels = [(record.levelno, record.message) for record in caplog.records]
    assert levels == [
        (logging.WARNING, "after 0 s"),
        (logging.DEBUG, "after 599 s"),
        (logging.DEBUG, "after 599 s"),
        (logging.WARNING, "after 601 s"),
    ]


async def test_texts_of_the_chassis_are_logged_as_one_short_line(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with linked() as (_peer, client, wire):
        await wire.send({"type": "error", "ok": False, "msg": "a\n[INFO] b\x1b[2J" + "x" * MIB})
        (logged,) = await eventually(
            lambda: [r.message for r in caplog.records if "reports" in r.message]
        )
        assert logged.isprintable()
        assert len(logged) < 1000
        answer = await answered(client.request(Speak()), wire, ok=False, msg="a\nb" * 1000)
        assert answer.msg == "a\nb" * 1000, "but callers get them as they are"


def test_a_logged_line_cannot_control_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(PrintableFormatter("%(levelname)s: %(message)s"))
    record = logging.LogRecord("x", logging.INFO, "", 0, "said %s", ("a\n\x1b]0;b\x07\x9bm",), None)
    try:
        raise ValueError("c\x1b[2J")
    except ValueError:
        record.exc_info = sys.exc_info()
    handler.handle(record)
    said, *traceback = capsys.readouterr().err.splitlines()
    assert said == "INFO: said a\\n\\x1b]0;b\\x07\\x9bm"
    assert traceback[0] == "Traceback (most recent call last):"
    assert traceback[-1] == "ValueError: c\\x1b[2J"


HOSTILE = {
    "nested lists": "[" * 100_000,
    "nested body": '{"type":"woosh.robot.PoseSpeed","body":' + "[" * 5000 + "]" * 5000 + "}",
    "nested unknown field": '{"type":"woosh.robot.PoseSpeed","body":{"new":'
    + "[" * 900
    + "]" * 900
    + "}}",
    "sn is an object": '{"type":"woosh.robot.PoseSpeed","sn":{},"body":{}}',
    "base64 of nothing but padding": '{"type":"woosh.common.FileData","body":{"data":"'
    + "=" * MIB
    + '"}}',
    "invalid base64": '{"type":"woosh.common.FileData","body":{"data":"' + "\\u0000" * 9 + '"}}',
    "a number out of range": '{"type":"woosh.robot.PoseSpeed","body":{"pose":{"x":1e308}}}',
    "any in any": '{"type":"woosh.dispatch.robot.RobotAnyInfo","body":{"info":'
    + '{"@type":"type.googleapis.com/google.protobuf.Any","value":' * 300
    + "{}"
    + "}" * 300
    + "}}",
}


async def test_a_hostile_push_or_answer_does_not_end_the_link() -> None:
    async with linked() as (_peer, client, wire):
        client.subscribe(PoseSpeed, lambda _push: None)
        for what, frame in HOSTILE.items():
            await wire.raw(frame)
            task = ask(client, Speak())
            asked = await wire.next("woosh.robot.Speak")
            await wire.raw(f'{{"sn":{asked["sn"]},' + frame.removeprefix("{"))
            await wire.answer(asked)
            await soon(task)
            assert (await answered(client.request(Speak()), wire)).ok, what
            assert client.stats.connects == 1, what
