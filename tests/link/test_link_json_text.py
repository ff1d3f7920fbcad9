"""JSON texts have the same value with and without orjson, and in pieces."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from woosh_robot_agent.link.codecs import json_text
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.pb.robot.robot_pb2 import ScannerData, TaskProc

BOTH_PARSERS = pytest.mark.usefixtures("parser")
VALUES = (
    *(None, True, False, "", "A2", "机器人 ß🤖", '\u2028\x7f\0\\/"\n', [], {}),
    *(0, -1, 2**31, 2**53 + 1, -(2**63), 2**64 - 1, 0.0, -0.0, 0.1, 1e-7, 1e16, 5e-324, 1.7e308),
    {"": [1, [2.5, {"a": None, "é": "b"}], []], "nested": {"x": {"y": [[], {}]}}},
)


@pytest.fixture(params=["as installed", "without orjson"])
def parser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "without orjson":
        monkeypatch.setattr(json_text, "ORJSON", None)


@BOTH_PARSERS
def test_each_value_is_read_and_written_as_by_the_standard_library() -> None:
    for value in (*VALUES, math.inf):
        for text in (json.dumps(value), json.dumps(value, ensure_ascii=False)):
            assert (
                repr(json_text.parse(text)) == repr(json_text.parse(text.encode())) == repr(value)
            )
    for value in (*VALUES, 10**30, "\ud800"):  # the last ones, orjson cannot write
        assert repr(json.loads(json_text.write(value))) == repr(value)


@BOTH_PARSERS
def test_deep_nesting_is_written() -> None:
    deep: list[Any] = []
    for _ in range(400):
        deep = [deep]
    assert json_text.write(deep) == "[" * 401 + "]" * 401


@BOTH_PARSERS
@pytest.mark.parametrize(
    "text",
    [
        '{"x":1,"x":2}',
        "[-0,-0.0,0e5,1E+2,4.9e-324,1.7976931348623157e308,1e999,-1e999]",
        "[NaN,Infinity,-Infinity]",
        r'["\ud800","\ud83d\ude00","\u0000","\/"]',
        " \r\n\t[]\n",
        "[" * 2000 + "]" * 2000,
    ],
)
def test_what_orjson_refuses_or_could_read_otherwise(text: str) -> None:
    try:
        expected = repr(json.loads(text))
    except RecursionError:
        with pytest.raises(RecursionError):
            json_text.parse(text)
    else:
        assert repr(json_text.parse(text)) == expected


@BOTH_PARSERS
def test_a_number_of_30_digits_is_a_float_and_fits_no_integer() -> None:
    codec = JsonCodec()
    envelope = codec.decode(json.dumps({"type": "t", "body": {"robotTaskId": 10**30}}))
    with pytest.raises(FrameError, match=r"robot_task_id: .* does not fit"):
        codec.body(envelope, TaskProc)
    body = {"rangeMax": 10**30, "ranges": [1, math.nan]}
    scan = codec.body(codec.decode(json.dumps({"type": "t", "body": body})), ScannerData)
    assert scan.range_max == pytest.approx(1e30)
    assert math.isnan(scan.ranges[1])


@pytest.mark.parametrize(
    "text",
    [
        json.dumps({"ranges": [7] * 50_000, "intensities": [8] * 50_000}),
        json.dumps(
            {"marks": [{"links": [{"x": 1}, {"y": 2}] * 4}] * 5000, "areas": [{"z": 3}] * 5000}
        ),
        json.dumps([*([1] * 9000), {"x": list(range(20_000))}] * 4),
        json.dumps([[[1, 2, 3]] * 900, [[4]] * 9000] * 4),
        json.dumps([{"x": 1}] * 9000, separators=(" , ", ": ")),
        "[" + ",".join(["[" * 80 + "[1]," * 9000 + "1" + "]" * 80] * 2) + "]",
        "{" + ",".join(f'"{key}":{"[" * 80}"{"x" * 33_000}"{"]" * 80}' for key in "ab") + "}",
    ],
    ids=[
        "two lists",
        "objects with lists",
        "large object in a list",
        "lists in lists",
        "spaces before commas",
        "deep lists",
        "deep lists in an object",
    ],
)
def test_no_part_of_a_long_text_is_parsed_again_and_again(
    text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    value = json.loads(text)
    parsed = 0
    loads, scan = json.loads, json_text._scan

    def counting_loads(piece: str) -> Any:
        nonlocal parsed
        parsed += len(piece)
        return loads(piece)

    def counting_scan(piece: str, at: int) -> tuple[Any, int]:
        nonlocal parsed
        try:
            found, end = scan(piece, at)
        except json.JSONDecodeError:
            parsed += len(piece) - at
            raise
        parsed += end - at
        return found, end

    monkeypatch.setattr(json, "loads", counting_loads)
    monkeypatch.setattr(json_text, "_scan", counting_scan)
    assert json_text.parse_in_pieces(text) == value
    assert parsed < 20 * len(text)
