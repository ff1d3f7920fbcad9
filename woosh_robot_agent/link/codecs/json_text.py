"""Read and write JSON texts, with orjson if it is installed, and the large base64 texts in frames.

A JSON parser looks at each character of a text, which takes longer than decoding base64. So long
base64 texts, e.g. maps of many MiB, are cut out of a frame before the frame is parsed.
"""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Iterator
from typing import Any

try:
    import pybase64 as _base64
except ImportError:  # not packaged everywhere; the standard library takes ten times as long
    import base64 as _base64

_LONG = 256 * 1024
"""Length from which a text is cut out, in characters."""
_STEP = _LONG // 2
"""Distance between the positions in a frame at which long texts are looked for, in characters."""
LONG_FRAME = _STEP
"""Length above which a frame is searched for long texts, in characters or bytes."""
_TOKEN = secrets.token_hex(16)
"""Start of the short texts that replace long texts; the sender of the frame cannot know it."""
_REPLACED = re.compile(rf"{_TOKEN}(\d+)")
"""Text that replaces a long one, with its number."""
LONG_MESSAGE = _LONG // 4 * 3
"""Size of the smallest message that can have a long text, in bytes."""
_SAMPLE = re.compile(r"[A-Za-z0-9+/_-]{64}")
"""Start of a base64 text that is long enough to be cut out."""


def read_base64(text: str) -> bytes:
    """Return the bytes that a base64 text stands for, in either alphabet, with or without padding.

    Raises:
        ValueError: the text is not base64.
    """
    try:
        return bytes(_base64.b64decode(text, validate=True))
    except ValueError:
        pass
    standard = text.replace("-", "+").replace("_", "/").rstrip("=")
    return bytes(_base64.b64decode(standard + "=" * (-len(standard) % 4), validate=True))


class LongBase64(str):
    """A base64 text that is long enough to be cut out."""

    __slots__ = ()


def write_base64(data: bytes) -> str:
    """Return the base64 text of some bytes."""
    text: str = _base64.b64encode(data).decode("ascii")
    return text if len(text) < _LONG else LongBase64(text)


def take_from_value(value: Any) -> list[str]:
    """Replace the texts of class `LongBase64` in a JSON value by short ones, before it is written.

    Returns:
        The texts, for `put_into_frame`.
    """
    texts: list[str] = []
    for outer, key, inner in _texts_in(value):
        if type(inner) is LongBase64:
            outer[key] = f"{_TOKEN}{len(texts)}"
            texts.append(inner)
    return texts


def put_into_frame(frame: str, texts: list[str]) -> str:
    """Return the written frame with the texts put back that `take_from_value` replaced."""
    return _REPLACED.sub(lambda found: texts[int(found[1])], frame)


def take_from_frame(frame: str | bytes) -> tuple[str | bytes, list[str]]:
    """Replace the long base64 texts in a JSON frame by short ones, before it is parsed.

    Looking for each quotation mark would take too long. So this looks for one mark after each step
    of `_STEP`: a text of twice that length contains a whole step. Shorter texts may stay.

    Returns:
        The shorter frame, or the frame itself without such a text; and the texts, for
        `put_into_value`.
    """
    quote: Any = b'"' if isinstance(frame, bytes) else '"'
    pieces: list[Any] = []
    texts: list[str] = []
    copied, at = 0, _STEP
    while at < len(frame) and (end := frame.find(quote, at)) >= 0:
        if end - at >= _STEP:  # no mark from `at` to `end`: probably inside of a long text
            begin = frame.rfind(quote, at - _STEP, at) + 1  # 0 if there is no mark
            text = _text(frame, begin, end) if begin else None
            if text is not None:
                token = f"{_TOKEN}{len(texts)}"
                pieces += frame[copied:begin], token.encode() if isinstance(frame, bytes) else token
                texts.append(text)
                copied = end
        at = end + _STEP  # shorter texts on the way are skipped
    if not texts:
        return frame, texts
    nothing: Any = frame[:0]
    return nothing.join((*pieces, frame[copied:])), texts


def _text(frame: str | bytes, begin: int, end: int) -> str | None:
    """Return the text between two quotation marks of a frame; None if it does not look like base64.

    It must begin like base64. Otherwise, the first mark may have been the end of a text, after
    which JSON has other characters. It must have no escapes, which only a JSON parser can read.
    """
    is_bytes = isinstance(frame, bytes)
    backslash: Any = b"\\" if is_bytes else "\\"
    sample = frame[begin : begin + 64]
    if not _SAMPLE.match(sample.decode("latin-1") if isinstance(sample, bytes) else sample):
        return None
    # from the character before the first mark on, because the mark itself may be escaped
    if frame.find(backslash, max(0, begin - 2), end) >= 0:
        return None
    if isinstance(frame, str):
        return frame[begin:end]
    try:
        return str(memoryview(frame)[begin:end], "ascii")
    except UnicodeDecodeError:
        return None


def put_into_value(value: Any, texts: list[str]) -> None:
    """Put the texts that `take_from_frame` replaced into the parsed value of the frame."""
    for outer, key, inner in _texts_in(value):
        if inner.startswith(_TOKEN):
            outer[key] = texts[int(inner[len(_TOKEN) :])]


def _texts_in(value: Any) -> Iterator[tuple[Any, Any, str]]:
    """Yield each text in a JSON value: the object or list, its key or index there, and the text."""
    stack = [value]
    while stack:
        outer = stack.pop()
        for key, inner in outer.items() if isinstance(outer, dict) else enumerate(outer):
            if isinstance(inner, str):
                yield outer, key, inner
            elif isinstance(inner, dict | list):
                stack.append(inner)


try:
    import orjson
except ImportError:  # no rosdep key has it; the standard library takes several times as long
    ORJSON: Any = None
else:
    ORJSON = orjson

_ENCODER = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def parse(text: str | bytes) -> Any:
    """Return the value of a JSON text; bytes are UTF-8.

    The standard library parses what orjson rejects. It also accepts NaN, infinity, numbers beyond
    the range of a double, lone surrogates and deeper nesting, and its errors give the position.

    Raises:
        UnicodeDecodeError: bytes are not UTF-8.
        ValueError: the text is not JSON.
        RecursionError: the text is nested too deeply.
    """
    if ORJSON is not None:
        try:
            return ORJSON.loads(text)
        except ORJSON.JSONDecodeError:
            pass
    return json.loads(text if isinstance(text, str) else text.decode())


def parse_in_pieces(text: str | bytes) -> Any:
    """Return the value of a long JSON text, as `parse` does.

    A JSON parser keeps all other threads from running until it returns. Here it gets the text in
    pieces, and other threads can run after each piece. The errors are those of `parse`.
    """
    text = text if isinstance(text, str) else text.decode()
    value, end = _Pieces(text).value(_after_space(text, 0))
    if _after_space(text, end) != len(text):
        raise json.JSONDecodeError("Extra data", text, end)
    return value


_PIECE = 32 * 1024
"""Length of the pieces, in characters. A parser takes about 0.5 ms for a piece."""
_DECODER = json.JSONDecoder()
_SPACE = re.compile(r"[ \t\n\r]*")
_CLOSING = {"{": "},", "[": "],"}
"""End of an item and the comma after it, by the first character of the items of a list."""
_SMALLEST_PIECE = 64
"""Length of the smallest piece that is tried before an item is parsed alone, in characters."""
_CUTS = 4
"""Maximum number of attempts to cut a piece of a list between two items."""
_MAX_FAILED = 16
"""Maximum total length of the pieces that cannot be parsed, as a multiple of the text's length."""


def _after_space(text: str, at: int) -> int:
    """Return the next position, from `at` on, that is no white space."""
    found = _SPACE.match(text, at)
    return at if found is None else found.end()


def _scan(text: str, at: int) -> tuple[Any, int]:
    """Return the value that begins at a position in the text, and the position of its end."""
    return _DECODER.raw_decode(text, at)


def _after_comma(text: str, at: int, closing: str) -> int:
    """Return the position of the item after the comma, or of the closing bracket of the list.

    `at` is the position where an item has ended.
    """
    at = _after_space(text, at)
    if text[at : at + 1] == ",":
        at = _after_space(text, at + 1)
        if text[at : at + 1] == closing:
            raise json.JSONDecodeError("Illegal trailing comma", text, at)
    elif text[at : at + 1] != closing:
        raise json.JSONDecodeError("Expecting ',' delimiter", text, at)
    return at


class _Pieces:
    """Parser of a text in pieces.

    A piece that was cut inside an item cannot be parsed. A text that needs too many attempts has
    its values parsed whole instead, so that the time is proportional to the length of any text.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._budget = _MAX_FAILED * len(text)
        """Number of characters that failed attempts may still parse."""

    def value(self, at: int) -> tuple[Any, int]:
        """Return the value that begins at a position in the text, and the position of its end."""
        text = self._text
        first = text[at : at + 1]
        if first not in ("{", "[") or self._budget <= 0:
            return _scan(text, at)
        piece = text[at : at + _PIECE]
        try:
            value, length = _scan(piece, 0)
        except json.JSONDecodeError:  # it is longer than a piece, or no JSON
            self._budget -= len(piece)
            return self._object(at) if first == "{" else self._list(at)
        return value, at + length

    def _object(self, at: int) -> tuple[dict[str, Any], int]:
        """Return the object that begins at a position in the text, and the position of its end."""
        text = self._text
        found: dict[str, Any] = {}
        at = _after_space(text, at + 1)
        while text[at : at + 1] != "}":
            if text[at : at + 1] != '"':
                raise json.JSONDecodeError("Expecting property name", text, at)
            name, at = _scan(text, at)
            at = _after_space(text, at)
            if text[at : at + 1] != ":":
                raise json.JSONDecodeError("Expecting ':' delimiter", text, at)
            found[name], at = self.value(_after_space(text, at + 1))
            at = _after_comma(text, at, "}")
        return found, at + 1

    def _list(self, at: int) -> tuple[list[Any], int]:
        """Return the list that begins at a position in the text, and the position of its end."""
        text = self._text
        found: list[Any] = []
        at = _after_space(text, at + 1)
        while text[at : at + 1] != "]":
            items, at = self._items(at)
            found += items
            at = _after_comma(text, at, "]")
        return found, at + 1

    def _items(self, at: int) -> tuple[list[Any], int]:
        """Return the next items of a list, at least one, and the position where the last one ends.

        A piece is tried first, then half a piece, and so on. If none can be cut after an item, or
        `_budget` is used up, one item is parsed alone.
        """
        size = _PIECE
        while size >= _SMALLEST_PIECE and self._budget > 0:
            items = self._cut(at, at + size)
            if items is None and size == _PIECE:  # it may hold the end of the list
                items = self._rest(at, at + size)
            if items is not None:
                return items
            size //= 2
        item, end = self.value(at)
        return [item], end

    def _cut(self, at: int, end: int) -> tuple[list[Any], int] | None:
        """Return the items up to a comma before the position `end`, and the position of that comma.

        The last comma that seems to follow an item is tried first. If it is inside an item, the one
        before it is tried, and so on. Return None after `_CUTS` attempts, or without such a comma.
        """
        text = self._text
        closing = _CLOSING.get(text[at : at + 1], ",")
        for _ in range(_CUTS):
            end = text.rfind(closing, at, end)
            if end < 0:
                break
            end += len(closing) - 1  # now at the comma after the item
            if end == at:
                break
            try:
                # this succeeds only if the cut is between two items
                return json.loads(f"[{text[at:end]}]"), end
            except json.JSONDecodeError:
                self._budget -= end - at
                end -= len(closing) - 1  # search before this cut
        return None

    def _rest(self, at: int, end: int) -> tuple[list[Any], int] | None:
        """Return the items up to the end of the list, and the position of its closing bracket.

        Return None if the list does not end before the position `end`, or is not JSON.
        """
        piece = self._text[at:end]
        try:
            items, length = _scan(f"[{piece}", 0)
        except json.JSONDecodeError:
            self._budget -= len(piece)
            return None
        return items, at + length - 2  # `length` counts the added bracket and the closing one


def write(value: Any) -> str:
    """Return a value as JSON text without spaces.

    The standard library writes what orjson rejects: integers of more than 64 bits, lone surrogates
    and deep nesting.

    Args:
        value: a value without NaN and infinity, which JSON does not have.

    Raises:
        TypeError: JSON has no such type.
        RecursionError: the value is nested too deeply.
    """
    if ORJSON is not None:
        try:
            text: str = ORJSON.dumps(value).decode()
        except ORJSON.JSONEncodeError:
            pass
        else:
            return text
    return _ENCODER.encode(value)
