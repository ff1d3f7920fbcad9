"""The .proto files as descriptors with their comments.

The files are compiled here, because the modules of `woosh_robot_agent.pb` hold no comments.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from google.protobuf.descriptor import Descriptor, EnumDescriptor, EnumValueDescriptor
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool

from woosh_robot_agent.interfaces.errors import InterfaceError

_Path = tuple[int, ...]
"""Place of an element in a file: field numbers of descriptor.proto and indices in turn."""


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
        for file in _compiled(folder).file:
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


def _compiled(folder: Path) -> FileDescriptorSet:
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
    """Return the comments of a file by full name of the element; a value's follows its enum's."""
    names = dict(_names(file))
    return {
        names[tuple(place.path)]: place.leading_comments.strip()
        for place in file.source_code_info.location
        if place.leading_comments and tuple(place.path) in names
    }


def _names(file: FileDescriptorProto) -> Iterator[tuple[_Path, str]]:
    number = FileDescriptorProto.DESCRIPTOR.fields_by_name
    for i, message in enumerate(file.message_type):
        yield from _message_names(message, (number["message_type"].number, i), file.package)
    for i, enum in enumerate(file.enum_type):
        yield from _enum_names(enum, (number["enum_type"].number, i), file.package)


def _message_names(
    message: DescriptorProto, path: _Path, scope: str
) -> Iterator[tuple[_Path, str]]:
    number = DescriptorProto.DESCRIPTOR.fields_by_name
    name = f"{scope}.{message.name}"
    yield path, name
    for i, field in enumerate(message.field):
        yield (*path, number["field"].number, i), f"{name}.{field.name}"
    for i, oneof in enumerate(message.oneof_decl):
        yield (*path, number["oneof_decl"].number, i), f"{name}.{oneof.name}"
    for i, nested in enumerate(message.nested_type):
        yield from _message_names(nested, (*path, number["nested_type"].number, i), name)
    for i, enum in enumerate(message.enum_type):
        yield from _enum_names(enum, (*path, number["enum_type"].number, i), name)


def _enum_names(enum: EnumDescriptorProto, path: _Path, scope: str) -> Iterator[tuple[_Path, str]]:
    number = EnumDescriptorProto.DESCRIPTOR.fields_by_name
    name = f"{scope}.{enum.name}"
    yield path, name
    for i, value in enumerate(enum.value):
        yield (*path, number["value"].number, i), f"{name}.{value.name}"
