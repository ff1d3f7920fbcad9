"""Serialization of ROS messages to CDR, the form in which DDS transports them.

rclpy serializes a message in one call into C, during which no other thread of Python runs: 50 ms
for a path of 60,000 poses. The functions here take as long, but in small steps, between which other
threads run. They are generated, one per message class. XTypes 1.3, clause 7.4.3 (encoding version
1), has the rules.
"""

from __future__ import annotations

import re
import struct
import sys
from array import array
from collections.abc import Callable
from functools import cache
from typing import Any

from woosh_robot_agent.convert.mapping import ARRAY_CODES, FunctionSource, class_of, item_type

_HEADER = bytes((0, sys.byteorder == "little", 0, 0))
"""Encapsulation header: plain CDR in the byte order of this computer."""
HEADER_SIZE = len(_HEADER)
"""Size of the encapsulation header, in bytes; alignment counts from its end."""
_FORMATS = {name: code for name, code in ARRAY_CODES.items() if name != "octet"} | {"boolean": "?"}
"""Format characters of `struct` by ROS type."""
_ARRAY = re.compile(r"(.+)\[(\d+)\]")
_SEQUENCE = re.compile(r"sequence<(.+?)(?:, (\d+))?>")
_Write = Callable[[bytearray, Any], None]
"""Appends a value to a buffer."""


def serialize(message: Any) -> bytes:
    """Return a ROS message as CDR, to be published as it is.

    Raises:
        TypeError: a field has a type that the interfaces of the robot do not use, e.g. octet.
    """
    ros_class: Any = type(message)
    out = bytearray(_HEADER)
    _writer(ros_class)(out, message)
    return bytes(out)


def packer(codes: str) -> Callable[[int], struct.Struct]:
    """Return a function that selects the Struct with which some numbers are appended to a buffer.

    CDR aligns each number to its size, counted from the end of the encapsulation header. So the
    padding in front of the numbers depends on the length of the buffer. There is one Struct for
    each length modulo 8, which is the argument of the function.

    Args:
        codes: format characters of `struct`, one for each number.
    """
    structs = []
    for start in range(8):
        at, padded = start, ""
        for code in codes:
            size = struct.calcsize("=" + code)
            padding = -at % size
            padded += f"{padding}x{code}"
            at += padding + size
        structs.append(struct.Struct("=" + padded))
    # indexed by the length of the buffer, which includes the header
    return [structs[(length - HEADER_SIZE) % 8] for length in range(8)].__getitem__


@cache
def _writer(ros_class: Any) -> _Write:
    """Return the function that appends a message of a class to a buffer."""
    source = FunctionSource("write(b, m)")
    run: list[tuple[str, str]] = []
    """Format character and expression of the numbers that are packed together."""

    def flush() -> None:
        """Write source for the numbers in `run`, and empty it."""
        if run:
            pack = source.bind(packer("".join(code for code, _ in run)))
            source.add(f"b += {pack}(len(b) & 7).pack({', '.join(value for _, value in run)})")
            run.clear()

    def add(cls: Any, path: str) -> None:
        """Write source for all fields of the message in the expression `path`."""
        types = cls.get_fields_and_field_types()
        if not types:
            run.append(("B", "0"))  # a struct has at least one member
        for name, ros_type in types.items():
            value = f"{path}.{name}"
            is_list = item_type(ros_type) is not None or "[" in ros_type
            if ros_type in _FORMATS:
                run.append((_FORMATS[ros_type], value))
            elif "/" in ros_type and not is_list:
                # a nested message: its fields follow without a header
                add(class_of(ros_type), value)
            else:
                flush()
                source.add(f"{source.bind(_field_writer(ros_type))}(b, {value})")

    add(ros_class, "m")
    flush()
    return source.compile()


def _field_writer(ros_type: str) -> _Write:
    """Return the function that appends a text, a sequence or an array to a buffer."""
    if ros_type == "string" or ros_type.startswith("string<"):
        return _write_text
    found = _ARRAY.fullmatch(ros_type) or _SEQUENCE.fullmatch(ros_type)
    if found is None:
        raise TypeError(f"cannot serialize the type {ros_type}")
    items, is_sequence = found[1], ros_type.startswith("sequence")
    if items in _FORMATS:
        write = _numbers_writer(_FORMATS[items])
    else:
        write_item = _writer(class_of(items)) if "/" in items else _field_writer(items)

        def write(out: bytearray, values: Any) -> None:
            for value in values:
                write_item(out, value)

    def write_sequence(out: bytearray, values: Any) -> None:
        out += _COUNT(len(out) & 7).pack(len(values))
        write(out, values)

    return write_sequence if is_sequence else write


def _numbers_writer(code: str) -> _Write:
    """Return the function that appends numbers, without their count, to a buffer.

    The first number is aligned to its size, counted from the end of the header.
    """
    size = struct.calcsize("=" + code)
    typecode = "B" if code == "?" else code

    def write(out: bytearray, values: Any) -> None:
        # arrays of Python and numpy have `tobytes`; a list does not, e.g. one of booleans
        data = values if hasattr(values, "tobytes") else array(typecode, values)
        if len(data):  # without a number, nothing is aligned
            out += bytes(-(len(out) - HEADER_SIZE) % size)
            out += data.tobytes()

    return write


def _write_text(out: bytearray, text: str) -> None:
    """Append a text to a buffer: the size with the final null byte, the UTF-8, and that byte."""
    data = text.encode()
    out += _COUNT(len(out) & 7).pack(len(data) + 1)
    out += data
    out.append(0)


_COUNT = packer("I")
"""Packer of the count before a text or a sequence."""
