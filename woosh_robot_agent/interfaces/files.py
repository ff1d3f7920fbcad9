"""All interface files, by path."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from google.protobuf.descriptor import EnumDescriptor

from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES
from woosh_robot_agent.interfaces.actions import action_file
from woosh_robot_agent.interfaces.enums import enum_file
from woosh_robot_agent.interfaces.errors import InterfaceError
from woosh_robot_agent.interfaces.messages import message_file
from woosh_robot_agent.interfaces.names import (
    PACKAGES,
    has_ros_message,
    message_name,
    oneof_message_name,
)
from woosh_robot_agent.interfaces.oneofs import oneof_file
from woosh_robot_agent.interfaces.own import OWN_MESSAGES
from woosh_robot_agent.interfaces.schema import Schema
from woosh_robot_agent.interfaces.services import command_file, query_file


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
        if not has_ros_message(element):
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
