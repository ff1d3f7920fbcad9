"""JSON texts have the same value with and without orjson, and in pieces; long base64 texts too."""

from __future__ import annotations

import base64
import json
import math
import random
from typing import Any

import pytest

from woosh_robot_agent.link.codecs import json_text
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.pb.map.map_pack_pb2 import DownloadResponse, Upload
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


# Long base64 texts, e.g. the files of a map: the JSON parser does not see them

CODEC = JsonCodec()
TYPE = "woosh.map.DownloadResponse"
DATA = random.Random(1).randbytes(240_000)
TEXT = base64.b64encode(DATA).decode()
OTHER = base64.b64encode(DATA[::-1]).decode()
LONG = 400_000

BODIES: dict[str, Any] = {
    "base64": {"fileDatas": [{"name": "map.png", "data": TEXT}]},
    "several": {"fileDatas": [{"data": TEXT}, {"name": "x" * 300, "data": OTHER}, {"data": TEXT}]},
    "other alphabet": {"data": TEXT.replace("+", "-").replace("/", "_").rstrip("=")},
    "in lists": [[TEXT, 1, None], [OTHER]],
    "words": {"text": "several words " * LONG},
    "quotes": {"text": '"' * LONG},
    "quote before": {"text": 'say "' + TEXT},
    "quote after": {"text": TEXT + '" she said'},
    "backslash before": {"text": "\\" + TEXT, "other": "\\"},
    "backslashes": {"text": "\\" * LONG},
    "not ASCII": {"text": TEXT + "\u8def"},
    "numbers": {"before": "b", "ranges": [1.25] * (LONG // 4), "after": TEXT},
    "colon at the end": {":": [7] * (LONG // 4), "[": [8] * (LONG // 4), "x": TEXT},
}


def frame(body: object, *, ensure_ascii: bool = True) -> str:
    return json.dumps({"type": TYPE, "body": body, "sn": 7, "ok": True}, ensure_ascii=ensure_ascii)


@pytest.mark.parametrize(
    ("name", "ensure_ascii"), [*((name, True) for name in BODIES), ("not ASCII", False)]
)
def test_a_frame_with_a_long_text_is_read_as_by_the_json_parser(
    name: str, ensure_ascii: bool
) -> None:
    text = frame(BODIES[name], ensure_ascii=ensure_ascii)
    for data in (text, text.encode()):
        envelope = CODEC.decode(data)
        assert envelope.body == BODIES[name]
        assert (envelope.type, envelope.sn, envelope.ok) == (TYPE, 7, True)


def test_a_long_name_does_not_hide_the_other_fields() -> None:
    message = CODEC.body(
        CODEC.decode(frame({TEXT: 1, "fileDatas": [{"data": OTHER}]})), DownloadResponse
    )
    assert message.file_datas[0].data == DATA[::-1]


@pytest.mark.parametrize("end", ["", "=", "=="])
def test_long_data_of_each_length_arrive(end: str) -> None:
    data = DATA[: 230_000 + len(end)]
    message = DownloadResponse()
    message.file_datas.add(name='a "name"', data=data)
    message.file_datas.add(name="other", data=DATA)
    text = CODEC.encode(TYPE, message, sn=3, ok=True)
    assert json.loads(text)["body"]["fileDatas"][0] == {
        "name": 'a "name"',
        "data": base64.b64encode(data).decode(),
    }
    for received in (text, text.encode()):
        assert CODEC.body(CODEC.decode(received), DownloadResponse) == message


def test_a_request_with_long_data_is_the_json_of_its_message() -> None:
    message = Upload(scene_name="b" * LONG)
    message.file_datas.add(name="map.png", data=DATA)
    written = json.loads(CODEC.encode("woosh.map.Upload", message, sn=1))["body"]
    assert written["sceneName"] == "b" * LONG
    assert written["fileDatas"] == [{"name": "map.png", "data": TEXT}]


@pytest.mark.parametrize(
    "text",
    [
        frame({"data": TEXT})[:-1],
        frame({"data": TEXT})[:250_000],
        '{"type":"x","body":{"a":"b"' + TEXT + '"}}',
        '{"type":"x","body":{"a":' + TEXT + '"}}',
        '"' + TEXT + '"',
    ],
    ids=["no end", "cut off", "after a text", "not quoted", "only a text"],
)
def test_a_bad_frame_with_a_long_text_is_refused(text: str) -> None:
    for data in (text, text.encode()):
        with pytest.raises(FrameError):
            CODEC.decode(data)


@pytest.mark.parametrize("bad", ["!", "é"])
def test_a_long_text_that_is_not_base64_is_no_data(bad: str) -> None:
    for at in (0, 5, LONG // 2, len(TEXT)):
        body = {"fileDatas": [{"data": TEXT[:at] + bad + TEXT[at:]}]}
        with pytest.raises(FrameError, match=r"fileDatas|file_datas"):
            CODEC.body(CODEC.decode(frame(body, ensure_ascii=False).encode()), DownloadResponse)
