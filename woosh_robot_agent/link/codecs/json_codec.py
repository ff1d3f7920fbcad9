"""JSON encoding: one object in a text frame. Real chassis are known to use this one."""

from __future__ import annotations

from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.base64_text import (
    LONG_FRAME,
    LONG_MESSAGE,
    cut_out,
    insert,
    put_back,
    take_out,
)
from woosh_robot_agent.link.codecs.frames import Envelope, FrameError, M, clip_type_name
from woosh_robot_agent.link.codecs.json_errors import BAD_VALUE, FieldError, brief_repr
from woosh_robot_agent.link.codecs.json_reader import from_json
from woosh_robot_agent.link.codecs.json_scalars import LONGEST_NUMBER
from woosh_robot_agent.link.codecs.json_text import parse, parse_in_pieces, write
from woosh_robot_agent.link.codecs.json_writer import to_json

_MAX_PARTS = 1_000_000
"""Maximum number of objects, lists and names in a frame. Two bytes of them on the wire can take a
hundred bytes of memory."""
_END_OF_TIME = 253_402_300_800_000
"""Unix time in ms at which the year 10000 begins, which no date can express."""


class JsonCodec:
    """Frames as JSON text.

    Args:
        defaults: include fields that have their default value, as the chassis does.
    """

    def __init__(self, *, defaults: bool = False) -> None:
        self._defaults = defaults

    def encode(
        self,
        type_name: str,
        body: Message | None,
        *,
        sn: int = 0,
        ok: bool | None = None,
        msg: str = "",
        timestamp: int | None = None,
    ) -> str:
        frame: dict[str, Any] = {
            "type": type_name,
            "body": {} if body is None else to_json(body, defaults=self._defaults),
        }
        if ok is not None:
            frame["ok"] = ok
            frame["msg"] = msg
        if sn:
            frame["sn"] = sn
        if timestamp is not None:
            frame["timestamp"] = timestamp
        long = body is not None and body.ByteSize() >= LONG_MESSAGE
        texts = take_out(frame) if long else []
        text = write(frame)
        return insert(text, texts) if texts else text

    def decode(self, data: str | bytes) -> Envelope:
        texts: list[str] = []
        try:
            if len(data) > LONG_FRAME:  # a shorter one has no long texts and few parts
                data, texts = cut_out(data)
                _check_parts(data)
                frame = parse_in_pieces(data)
            else:
                frame = parse(data)
        except UnicodeDecodeError as error:
            raise FrameError("utf-8", f"not UTF-8: {error}") from None
        except (ValueError, RecursionError) as error:
            raise FrameError("json", f"not JSON: {error}") from None
        if not isinstance(frame, dict):
            raise FrameError("envelope", f"not a JSON object but {type(frame).__name__}")
        if texts:
            put_back(frame, texts)
        ok = frame.get("ok")
        try:
            sn = _integer(frame.get("sn")) or 0
        except BAD_VALUE as error:
            raise FrameError("envelope", f"sn is not an integer: {error}") from None
        timestamp, defect = _time(frame.get("timestamp"))
        type_name = frame.get("type")
        type_name = clip_type_name(_text(type_name)) if isinstance(type_name, str) else ""
        if not type_name and not sn:  # an answer needs only its sn
            raise FrameError("envelope", "no type")
        return Envelope(
            type=type_name,
            body=frame.get("body"),
            ok=None if ok is None else ok in (True, "true"),
            msg=_text(frame["msg"]) if "msg" in frame else "",
            sn=sn,
            timestamp=timestamp,
            defect=defect,
        )

    def body(self, envelope: Envelope, cls: type[M]) -> M:
        message = cls()
        if envelope.body is not None:
            try:
                from_json(envelope.body, message)
            except FieldError as error:
                raise FrameError("body", f"{envelope.type}: {error}") from None
        return message


def _check_parts(text: str | bytes) -> None:
    if len(text) > _MAX_PARTS:
        marks: Any = "{[:" if isinstance(text, str) else (b"{", b"[", b":")
        parts = sum(text.count(mark) for mark in marks)
        if parts > _MAX_PARTS:
            raise FrameError(
                "oversize", f"{parts} objects, lists and names in one frame, more than {_MAX_PARTS}"
            )


def _integer(value: Any) -> int | None:
    if value is None or type(value) is int:
        return value
    if isinstance(value, str) and len(value) > LONGEST_NUMBER:
        raise ValueError("it is too long for a number")
    if isinstance(value, bool):
        raise TypeError("a boolean")
    number = int(value)
    if isinstance(value, float) and number != value:
        raise ValueError("it has a fraction")
    return number


def _time(value: object) -> tuple[int | None, str]:
    """Return the time in `timestamp`, and what is wrong with it; its frame is valid without it."""
    try:
        time = _integer(value)
    except BAD_VALUE as error:
        return None, f"timestamp is not an integer: {error}"
    if time is not None and not 0 <= time < _END_OF_TIME:
        return None, f"timestamp is out of range: {brief_repr(time)}"
    return time, ""


def _text(value: object) -> str:
    """Return a value of the envelope as text; values of other types are tolerated."""
    if not isinstance(value, str):
        return str(value) if isinstance(value, int | float) else ""
    if value.isascii():
        return value
    # JSON can hold half a surrogate pair; logs and ROS messages cannot
    return value.encode("utf-8", "replace").decode()
