"""Long base64 texts in JSON frames, e.g. the files of a map: the JSON parser does not see them."""

from __future__ import annotations

import base64
import json
import random
from typing import Any

import pytest

from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.pb.map.map_pack_pb2 import DownloadResponse, Upload

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
