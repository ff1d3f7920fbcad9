"""The interface files of the packages `woosh_*_msgs`, generated from proto/ and the endpoints.

The ROS messages mirror the protobuf messages:

- The packages are those in `PACKAGES`; messages of others have a name in `OTHERS`.
  The message of a nested message `A.B` is `AB`.
- An enum is a message with its values as `int32` constants and one field `int32 value`. The
  constant of `kRosSuccess` is `K_ROS_SUCCESS`.
- Fields have the same names and order. `bytes` is `uint8[]`, google.protobuf.Any is
  `woosh_common_msgs/AnyProto`.
- The oneof `x` of a message `M` is a field `x` after the other fields. Its type `MOneOfX` has a
  field and a constant for each member, and `which`, which holds the constant of the member that is
  set. `x_choice` repeats it for old clients.
- If a message has fields of message types that are neither repeated nor members of a oneof, it ends
  with the bit mask `has_field`, of the smallest type that has a bit for each protobuf field. Bit i
  is the presence of the i-th protobuf field. By default, all bits are set.

Services and actions have one shape for each kind of endpoint:

- The request of a query is empty, or has the message of the request as `arg`. The response has the
  message of the answer as its only field.
- The request of a command has the message of the request as `arg`. The response has `ok` and `msg`,
  and before them `ret` if the answer has content.
- The goal of an action has `arg`, its result `ret`, and its feedback `fb`.

Comments come from the .proto files, the single source of what a field means. So the files need no
changes by hand: edit proto/ or `endpoints.py`, and run `python3 -m scripts.generate`.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from google.protobuf.descriptor import (
    Descriptor,
    EnumDescriptor,
    EnumValueDescriptor,
    FieldDescriptor,
    OneofDescriptor,
)
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool

from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, Action, Command, Query
from woosh_robot_agent.link.codecs.json_codec import is_repeated


class InterfaceError(Exception):
    """The interface files cannot be generated; the text says why."""


_Location = tuple[int, ...]
"""Place of an element in a file, as `source_code_info` has it: field number, index, and so on."""


class Schema:
    """The messages and enums of a folder of .proto files, with their comments.

    Args:
        folder: folder that the imports of the files are relative to.

    Raises:
        InterfaceError: there is no protobuf compiler, or a file does not compile.
    """

    def __init__(self, folder: Path) -> None:
        self._pool = DescriptorPool()
        self._comments: dict[str, str] = {}
        self._files: list[Any] = []
        for file in _compile(folder).file:
            self._pool.AddSerializedFile(file.SerializeToString())
            self._files.append(self._pool.FindFileByName(file.name))
            self._comments |= _comments(file)

    def message(self, full_name: str) -> Descriptor:
        """Return a message.

        Raises:
            InterfaceError: there is no message with this full name.
        """
        try:
            return self._pool.FindMessageTypeByName(full_name)
        except KeyError:
            text = f"an endpoint names a message that proto/ does not define: {full_name}"
            raise InterfaceError(text) from None

    def types(self) -> Iterator[Descriptor | EnumDescriptor]:
        """Yield all messages and enums, nested ones included."""
        for file in self._files:
            yield from file.enum_types_by_name.values()
            for message in file.message_types_by_name.values():
                yield from _with_nested(message)

    def comment(self, element: Any) -> str:
        """Return the comment above a message, field, oneof, enum or value; empty if it has none."""
        if isinstance(element, EnumValueDescriptor):
            return self._comments.get(f"{element.type.full_name}.{element.name}", "")
        return self._comments.get(element.full_name, "")


def _compile(folder: Path) -> FileDescriptorSet:
    """Return the descriptors of all .proto files in a folder, with their comments."""
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*.proto"))
    with tempfile.TemporaryDirectory() as temporary:
        output = Path(temporary) / "descriptors"
        options = ["--include_imports", "--include_source_info", f"--descriptor_set_out={output}"]
        run = subprocess.run(
            [*_compiler(), f"-I{folder}", *options, *names], capture_output=True, text=True
        )
        if run.returncode:
            raise InterfaceError(f"the .proto files do not compile: {run.stderr.strip()}")
        return FileDescriptorSet.FromString(output.read_bytes())


def _compiler() -> list[str]:
    """Return the command of the compiler: grpcio-tools, or protoc on the PATH."""
    spec = importlib.util.find_spec("grpc_tools")
    if spec and spec.origin:
        # the .proto files of protobuf itself, e.g. google/protobuf/any.proto
        include = Path(spec.origin).parent / "_proto"
        return [sys.executable, "-m", "grpc_tools.protoc", f"-I{include}"]
    if path := shutil.which("protoc"):
        return [path]
    raise InterfaceError(
        "no protobuf compiler; run pip install grpcio-tools, or apt-get install protobuf-compiler"
    )


def _with_nested(message: Descriptor) -> Iterator[Descriptor | EnumDescriptor]:
    yield message
    yield from message.enum_types
    for nested in message.nested_types:
        yield from _with_nested(nested)


def _comments(file: FileDescriptorProto) -> dict[str, str]:
    """Return the comments of a file by full name; that of an enum value is ENUM.VALUE."""
    names = dict(_names(file))
    return {
        names[tuple(each.path)]: each.leading_comments.strip()
        for each in file.source_code_info.location
        if each.leading_comments and tuple(each.path) in names
    }


def _names(file: FileDescriptorProto) -> Iterator[tuple[_Location, str]]:
    """Yield location and full name of each element of a file."""
    fields = FileDescriptorProto.DESCRIPTOR.fields_by_name
    for i, message in enumerate(file.message_type):
        yield from _message_names(message, (fields["message_type"].number, i), file.package)
    for i, enum in enumerate(file.enum_type):
        yield from _enum_names(enum, (fields["enum_type"].number, i), file.package)


def _message_names(
    message: DescriptorProto, location: _Location, scope: str
) -> Iterator[tuple[_Location, str]]:
    fields = DescriptorProto.DESCRIPTOR.fields_by_name
    name = f"{scope}.{message.name}"
    yield location, name
    for i, field in enumerate(message.field):
        yield (*location, fields["field"].number, i), f"{name}.{field.name}"
    for i, oneof in enumerate(message.oneof_decl):
        yield (*location, fields["oneof_decl"].number, i), f"{name}.{oneof.name}"
    for i, nested in enumerate(message.nested_type):
        yield from _message_names(nested, (*location, fields["nested_type"].number, i), name)
    for i, enum in enumerate(message.enum_type):
        yield from _enum_names(enum, (*location, fields["enum_type"].number, i), name)


def _enum_names(
    enum: EnumDescriptorProto, location: _Location, scope: str
) -> Iterator[tuple[_Location, str]]:
    fields = EnumDescriptorProto.DESCRIPTOR.fields_by_name
    name = f"{scope}.{enum.name}"
    yield location, name
    for i, value in enumerate(enum.value):
        yield (*location, fields["value"].number, i), f"{name}.{value.name}"


@dataclass(frozen=True)
class Line:
    """A line that defines a field or a constant.

    Attributes:
        definition: the line, e.g. `uint8 has_field 255`.
        comment: text of the comment above it; empty for none.
    """

    definition: str
    comment: str = ""


def message_text(comment: str, *blocks: Sequence[Line]) -> str:
    """Return the content of a .msg file.

    Args:
        comment: comment at the top of the file.
        blocks: lines that stand together; an empty line precedes each block.
    """
    return "\n".join([_comment(comment), *map(_block, filter(None, blocks))])


def parts_text(comment: str, *parts: Sequence[Line]) -> str:
    """Return the content of a .srv or .action file.

    Args:
        comment: comment at the top of the file.
        parts: fields of each part.
    """
    return f"{_comment(comment)}\n" + "---\n".join(map(_block, parts))


def _block(lines: Sequence[Line]) -> str:
    return "".join(f"{_comment(line.comment)}{line.definition}\n" for line in lines)


def _comment(text: str) -> str:
    return "".join(f"# {line.strip()}".rstrip() + "\n" for line in text.strip().splitlines())


PACKAGES = {
    "woosh.action": "woosh_action_msgs",
    "woosh.common": "woosh_common_msgs",
    "woosh.map": "woosh_map_msgs",
    "woosh.map.field": "woosh_map_msgs",
    "woosh.map.mark": "woosh_map_msgs",
    "woosh.map.path": "woosh_map_msgs",
    "woosh.nav": "woosh_nav_msgs",
    "woosh.robot": "woosh_robot_msgs",
    "woosh.robot.count": "woosh_robot_msgs",
    "woosh.robot.setting": "woosh_robot_msgs",
    "woosh.ros": "woosh_ros_msgs",
    "woosh.ros.action": "woosh_ros_msgs",
    "woosh.task": "woosh_task_msgs",
}
"""ROS package of each protobuf package whose messages and enums all have a ROS message."""
OTHERS = {
    "woosh.device.RfRemoteController": "woosh_robot_msgs/RfRemoteController",
    "woosh.map.mark.storage.Create": "woosh_map_msgs/StorageCreate",
    "woosh.map.mark.storage.Delete": "woosh_map_msgs/StorageDelete",
    "woosh.map.mark.storage.Find": "woosh_map_msgs/StorageFind",
    "woosh.map.mark.storage.Storages": "woosh_map_msgs/StorageStorages",
    "woosh.map.mark.storage.Update": "woosh_map_msgs/StorageUpdate",
}
"""ROS messages of the messages of other protobuf packages that endpoints need."""

ANY = "google.protobuf.Any"
"""Full name of the protobuf message that holds a message of any type."""
ANY_MESSAGE = "woosh_common_msgs/AnyProto"
"""The ROS message that stands for `ANY`."""

_WORD_STARTS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def message_name(element: Descriptor | EnumDescriptor) -> str:
    """Return package and name of the ROS message, e.g. `woosh_robot_msgs/BatteryChargeState`.

    Raises:
        InterfaceError: it has no ROS message.
    """
    if element.full_name == ANY:
        return ANY_MESSAGE
    if element.full_name in OTHERS:
        return OTHERS[element.full_name]
    package: str = element.file.package
    if package not in PACKAGES:
        raise InterfaceError(
            f"a field or an endpoint needs a message that has no ROS message; name one in "
            f"interface_files.py: {element.full_name}"
        )
    return f"{PACKAGES[package]}/{element.full_name[len(package) :].replace('.', '')}"


def oneof_message_name(oneof: OneofDescriptor) -> str:
    """Return package and name of the ROS message, e.g. `woosh_ros_msgs/CallActionOneOfAction`."""
    return f"{message_name(oneof.containing_type)}OneOf{_camel_case(oneof.name)}"


def enum_constant(value_name: str) -> str:
    """Return the name of an enum value's constant, e.g. `K_ROS_SUCCESS` for `kRosSuccess`."""
    return _WORD_STARTS.sub("_", value_name).upper()


def member_constant(oneof: OneofDescriptor, member: str = "") -> str:
    """Return the name of the constant for a member of a oneof, or for none of its members."""
    return f"{oneof.name}_{member}_SET".upper() if member else f"{oneof.name}_NOT_SET".upper()


def _camel_case(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_"))


_SCALARS = {
    FieldDescriptor.TYPE_DOUBLE: "float64",
    FieldDescriptor.TYPE_FLOAT: "float32",
    FieldDescriptor.TYPE_INT64: "int64",
    FieldDescriptor.TYPE_SINT64: "int64",
    FieldDescriptor.TYPE_SFIXED64: "int64",
    FieldDescriptor.TYPE_UINT64: "uint64",
    FieldDescriptor.TYPE_FIXED64: "uint64",
    FieldDescriptor.TYPE_INT32: "int32",
    FieldDescriptor.TYPE_SINT32: "int32",
    FieldDescriptor.TYPE_SFIXED32: "int32",
    FieldDescriptor.TYPE_UINT32: "uint32",
    FieldDescriptor.TYPE_FIXED32: "uint32",
    FieldDescriptor.TYPE_BOOL: "bool",
    FieldDescriptor.TYPE_STRING: "string",
    FieldDescriptor.TYPE_BYTES: "uint8[]",
}
_NUMBERS = {"woosh.task.TaskSetBase.rtype": "uint32"}
"""Enum fields that are plain numbers, as the package of the enum depends on that of the field."""


def field_type(field: FieldDescriptor) -> str:
    """Return the ROS type of a field, e.g. `woosh_common_msgs/Point[]`."""
    if field.full_name in _NUMBERS:
        name = _NUMBERS[field.full_name]
    elif structure := field.message_type or field.enum_type:
        name = message_name(structure)
    else:
        name = _SCALARS[field.type]
    return f"{name}[]" if is_repeated(field) else name


_MASK_COMMENT = (
    "Presence of the message-typed fields, one bit each; all ones means that all are present"
)


def presence_mask(fields: Sequence[FieldDescriptor]) -> tuple[list[Line], list[Line]]:
    """Return the constants for the bits and the mask itself; nothing if no field needs a bit."""
    with_bit = [
        field
        for field in fields
        if field.message_type and not field.containing_oneof and not is_repeated(field)
    ]
    if not with_bit:
        return [], []
    size = next(size for size in (8, 16, 32, 64) if len(fields) <= size)
    title = "Bits of `has_field`"
    constants = [
        Line(f"uint{size} {field.name.upper()}_FIELD_SET={1 << field.index}", "" if i else title)
        for i, field in enumerate(with_bit)
    ]
    return constants, [Line(f"uint{size} has_field {2**size - 1}", _MASK_COMMENT)]


_ARG_COMMENT = "The request to the chassis"
"""Comment of the field `arg` of requests and goals."""


def query_file(query: Query, schema: Schema) -> str:
    """Return the .srv file of a query."""
    message = schema.message(query.request)
    name = message_name(message)
    value = "Current value of the chassis, or the last known one if the chassis does not answer"
    return parts_text(
        f"{schema.comment(message)}\nAsks the chassis for {query.request}.",
        [Line(f"{name} arg", _ARG_COMMENT)] if query.takes_arg else [],
        [Line(f"{name} {query.field}", value)],
    )


def command_file(command: Command, schema: Schema) -> str:
    """Return the .srv file of a command."""
    message = schema.message(command.request)
    response = [
        Line("bool ok", "True when the chassis accepted the request"),
        Line(
            "string msg",
            "Text of the chassis's answer; without an answer, the cause and the remedy",
        ),
    ]
    if command.answer:
        answer = message_name(schema.message(command.answer))
        text = "Answer of the chassis; default values if there was none"
        response.insert(0, Line(f"{answer} ret", text))
    return parts_text(
        f"{schema.comment(message)}\nSends {command.request}.",
        [Line(f"{message_name(message)} arg", _ARG_COMMENT)],
        response,
    )


def action_file(action: Action, schema: Schema) -> str:
    """Return the .action file of an action."""
    message = schema.message(action.arg)
    report = message_name(schema.message(action.feedback))
    return parts_text(
        f"{schema.comment(message)}\nStarts {action.arg} and follows its reports.",
        [Line(f"{message_name(message)} arg", _ARG_COMMENT)],
        [Line(f"{report} ret", "The last report of the chassis, which ended the goal")],
        [Line(f"{report} fb", "Progress report of the chassis")],
    )


def enum_file(enum: EnumDescriptor, schema: Schema) -> str:
    """Return the .msg file of an enum."""
    constants = [
        Line(f"int32 {enum_constant(value.name)}={value.number}", schema.comment(value))
        for value in enum.values
    ]
    return message_text(
        f"{schema.comment(enum)}\nMirrors {enum.full_name}.",
        constants,
        [Line("int32 value", "One of the constants above")],
    )


_LEFT_OUT = frozenset({"woosh.robot.ScannerData.offset"})
"""Fields that are newer than their ROS message, whose type hash must not change."""


def message_file(message: Descriptor, schema: Schema) -> str:
    """Return the .msg file of a message. The messages of its oneofs have files of their own."""
    fields = [field for field in message.fields if field.full_name not in _LEFT_OUT]
    lines = [
        Line(f"{field_type(field)} {field.name}", schema.comment(field))
        for field in fields
        if field.containing_oneof is None
    ]
    for oneof in message.oneofs:
        text = f"The oneof `{oneof.name}`: at most one of its members is set"
        lines.append(Line(f"{oneof_message_name(oneof)} {oneof.name}", text))
    constants, mask = presence_mask(fields)
    return message_text(
        f"{schema.comment(message)}\nMirrors {message.full_name}.", constants, lines + mask
    )


def oneof_file(oneof: OneofDescriptor, schema: Schema) -> str:
    """Return the .msg file of a oneof."""
    message = oneof.containing_type.full_name
    constants = [Line(f"int8 {member_constant(oneof)}=0", "Values of `which`")]
    constants += [
        Line(f"int8 {member_constant(oneof, field.name)}={number}")
        for number, field in enumerate(oneof.fields, start=1)
    ]
    fields = [
        Line(f"{field_type(field)} {field.name}", schema.comment(field)) for field in oneof.fields
    ]
    choice = "Same as `which`, for older clients; used if `which` is 0"
    return message_text(
        f"Which member of the oneof `{oneof.name}` of {message} is set, and its value.",
        constants,
        [
            *fields,
            Line(f"int8 {oneof.name}_choice", choice),
            Line("int8 which", "Constant of the member that is set"),
        ],
    )


OWN_MESSAGES = {
    "woosh_robot_msgs/AgentInfo": message_text(
        "State of the agent",
        [Line("bool online", "True while the link to the chassis is ready")],
    )
}
"""Content of the .msg files that mirror no protobuf message, by ROS type."""


def interface_files(proto: Path) -> dict[str, str]:
    """Return the content of all interface files, by path relative to the root of the checkout.

    Args:
        proto: folder that the imports of the .proto files are relative to.

    Raises:
        InterfaceError: proto/ does not compile, or does not suit the table of endpoints.
    """
    files: dict[str, str] = {}
    for path, text in _files(Schema(proto)):
        # endpoints may share a type: setting/Identity and setting/SetIdentity do
        if files.setdefault(path, text) != text:
            raise InterfaceError(f"there are two definitions of a file; rename one: {path}")
    return files


def superfluous_files(root: Path, wanted: Collection[str]) -> Iterator[Path]:
    """Yield the interface files of a checkout that the build would find, but nothing defines.

    Args:
        root: root of the checkout.
        wanted: paths of the files that are defined, relative to the root.
    """
    for package in sorted(set(PACKAGES.values())):
        for kind in ("msg", "srv", "action"):
            for path in sorted((root / package / kind).glob(f"*.{kind}")):
                if path.relative_to(root).as_posix() not in wanted:
                    yield path


def _files(schema: Schema) -> Iterator[tuple[str, str]]:
    for element in schema.types():
        if element.full_name not in OTHERS and element.file.package not in PACKAGES:
            continue
        if isinstance(element, EnumDescriptor):
            yield _path(message_name(element), "msg"), enum_file(element, schema)
            continue
        yield _path(message_name(element), "msg"), message_file(element, schema)
        for oneof in element.oneofs:
            yield _path(oneof_message_name(oneof), "msg"), oneof_file(oneof, schema)
    for name, text in OWN_MESSAGES.items():
        yield _path(name, "msg"), text
    for query in QUERIES:
        yield _path(query.srv, "srv"), query_file(query, schema)
    for command in COMMANDS:
        yield _path(command.srv, "srv"), command_file(command, schema)
    for action in ACTIONS:
        yield _path(action.action, "action"), action_file(action, schema)


def _path(name: str, kind: str) -> str:
    package, short = name.split("/")
    return f"{package}/{kind}/{short}.{kind}"
