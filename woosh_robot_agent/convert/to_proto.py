"""Conversion from ROS to protobuf: one generated function per pair of types.

Values that must not be sent to the robot, non-finite numbers and invalid text, raise BadFieldError.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from woosh_robot_agent.convert.mapping import (
    BadFieldError,
    FunctionSource,
    class_of,
    item_type,
    message_class,
    mirrored_fields,
    presence_bits,
)
from woosh_robot_agent.link.codecs.json_codec import FLOATS


@cache
def filler(ros_class: Any, proto_class: Any) -> Callable[[Any, Any], None]:
    """Return a function `fill(p, r)` that copies a ROS message `r` into a protobuf message `p`."""
    source = FunctionSource(
        "fill(p, r)", BadField=BadFieldError, check_text=_check_text, isfinite=math.isfinite
    )
    bits = presence_bits(ros_class, proto_class)
    if bits is not None:
        source.add("has = r.has_field")
    for name, ros_type, field in mirrored_fields(ros_class, proto_class):
        if bits is not None and name in bits:
            source.add(f"if has & {bits[name]}:")
            _set_proto(source, "r", name, ros_type, field, indent="    ")
        else:
            _set_proto(source, "r", name, ros_type, field)
    for group in proto_class.DESCRIPTOR.oneofs:
        inner_class = class_of(ros_class.get_fields_and_field_types()[group.name])
        types = inner_class.get_fields_and_field_types()
        # old clients set only `*_choice`
        source.add(f"o = r.{group.name}; which = o.which or o.{group.name}_choice")
        for number, field in enumerate(group.fields, 1):
            source.add(f"{'el' if number > 1 else ''}if which == {number}:")
            inner = f"{group.name}.{field.name}"
            _set_proto(source, "o", field.name, types[field.name], field, indent="    ", path=inner)
        source.add("elif which:")
        source.add(
            f"    raise BadField('{group.name}.which', f'it is {{which}}, which is not a member')"
        )
    return source.compile()


def _set_proto(
    source: FunctionSource,
    origin: str,
    name: str,
    ros_type: str,
    field: Any,
    indent: str = "",
    path: str = "",
) -> None:
    """Write source that copies a field of a ROS message to the protobuf message `p`.

    Args:
        origin: name of the variable that holds the ROS message in the generated function.
        field: protobuf descriptor of the field.
        indent: indentation inside of the function.
        path: path of the field for errors; by default its name.
    """
    path = path or name

    def add(line: str) -> None:
        source.add(indent + line)

    items = item_type(ros_type)
    if field.message_type is not None:
        fill = source.bind(filler(class_of(items or ros_type), message_class(field)))
        if items is None:
            add(f"inner = p.{name}; inner.SetInParent()")
            add(f"try: {fill}(inner, {origin}.{name})")
            add(f"except BadField as error: raise error.below('{path}') from None")
        else:
            add(f"for i, item in enumerate({origin}.{name}):")
            add(f"    try: {fill}(p.{name}.add(), item)")
            add(f"    except BadField as error: raise error.below(f'{path}[{{i}}]') from None")
    elif field.enum_type is not None:
        if items is not None:
            add(f"p.{name}.extend([item.value for item in {origin}.{name}])")
        elif "/" in ros_type:
            add(f"p.{name} = {origin}.{name}.value")
        else:
            # an unsigned field: values from 2^31 stand for negative enum values
            add(f"p.{name} = ({origin}.{name} ^ 0x80000000) - 0x80000000")
    elif field.type == FieldDescriptor.TYPE_BYTES:
        add(f"p.{name} = bytes({origin}.{name})")
    elif items is not None:
        if field.cpp_type in FLOATS:
            add(f"for i, item in enumerate({origin}.{name}):")
            add(f"    if not isfinite(item): raise BadField(f'{path}[{{i}}]', f'it is {{item}}')")
        elif items == "string":
            add(f"for i, item in enumerate({origin}.{name}): check_text(item, f'{path}[{{i}}]')")
        add(f"p.{name}.extend({origin}.{name})")
    elif field.cpp_type in FLOATS:
        add(f"value = {origin}.{name}")
        add(f"if not isfinite(value): raise BadField('{path}', f'it is {{value}}')")
        add(f"p.{name} = value")
    elif field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
        add(f"value = {origin}.{name}; check_text(value, '{path}'); p.{name} = value")
    else:
        add(f"p.{name} = {origin}.{name}")


def _check_text(text: str, path: str) -> None:
    """Raise BadFieldError for a text with a lone surrogate, which UTF-8 cannot encode."""
    if text.isascii():
        return
    try:
        text.encode()
    except UnicodeEncodeError:
        raise BadFieldError(path, "it is not valid UTF-8 text") from None
