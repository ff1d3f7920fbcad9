"""The marks of a map as a YAML file that people can edit."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import yaml
from google.protobuf.json_format import MessageToDict, ParseDict, ParseError

from woosh_robot_agent.pb.map.mark_pb2 import MarkInfo, Storage
from woosh_robot_agent.simulator.yaml_fields import DataFileError, Node, parse
from woosh_robot_agent.tools.maps.errors import MapsError

_TYPES = tuple(field.name for field in Storage.DESCRIPTOR.oneofs_by_name["category"].fields)
"""Types of marks: the categories of `woosh.map.mark.Storage`."""
_BASE = "base"
"""Type of a mark without a category."""
_MARKS, _OTHERS = "marks", "others"
"""Keys of the file: the storage places, and all other marks."""
_MAX_BYTES = 8 * 1024 * 1024
"""Maximum size of a file, in bytes."""
_MAX_MARKS = 100_000
"""Maximum number of marks in a file."""
_UINT32 = 2**32 - 1
"""Greatest possible id of a mark."""
_HEADING = """\
# Marks of map {map}. Edit this file, then upload the folder: maps --ip ... upload --force FOLDER
#
# pose is where a robot stands at the mark: [x, y, theta], in m and rad. real is the pose of the
# place itself, if it differs. A mark without an id gets a free one.
# Types: {types}.
"""


def write_marks(info: MarkInfo, map_name: str) -> bytes:
    """Return the marks of a map as YAML."""
    heading = _HEADING.format(map=repr(map_name), types=", ".join((_BASE, *_TYPES)))
    content = {_MARKS: [_entry(storage) for storage in info.storages], _OTHERS: _others(info)}
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None)
    return (heading + text).encode()


def read_marks(name: str, data: bytes, old: MarkInfo) -> MarkInfo:
    """Return the marks that a file describes; `old` itself if the file describes the same ones.

    Args:
        name: Name of the file, for errors.
        data: Content of the file.
        old: The marks at the time when the file was written. Data that this program does not know
            are taken from them.

    Raises:
        MapsError: The file cannot be used.
    """
    try:
        root = parse(name, data, _MAX_BYTES).check_keys((_MARKS, _OTHERS))
        nodes = list(root.required(_MARKS).items(_MAX_MARKS))
        storages = _storages(nodes, old.storages)
        others = root.get(_OTHERS)
        same_others = (others.value if others else {}) == _others(old)
        if same_others and storages == list(old.storages):
            return old
        new = MarkInfo()
        new.CopyFrom(old)
        if others and not same_others:
            new = _parsed(others, MarkInfo(version=old.version))
        del new.storages[:]
        new.storages.extend(storages)
    except DataFileError as error:
        raise MapsError(str(error)) from None
    return new


def _storages(nodes: list[Node], old: Iterable[Storage]) -> list[Storage]:
    """Return the marks of a file. An unchanged one is the one of `old`."""
    unchanged = {storage.identity.no: storage for storage in old}
    storages: list[Storage] = []
    changed: list[Storage] = []
    numbers: set[str] = set()
    ids: set[int] = set()
    for node in nodes:
        number = node.required("number").text()
        before = unchanged.get(number)
        if before and _entry(before) == node.value:
            storage = before
        else:
            storage = _storage(node)
            changed.append(storage)
        id_ = storage.identity.id
        if number in numbers or (id_ and id_ in ids):
            raise node.error(f"number {number} or id {id_} is used twice")
        numbers.add(number)
        ids.add(id_)
        storages.append(storage)
    for storage in changed:
        if not storage.identity.id:
            storage.identity.id = max(ids) + 1
            ids.add(storage.identity.id)
    return storages


def _entry(storage: Storage) -> dict[str, Any]:
    """Return a mark as in the file."""
    fields = MessageToDict(storage, preserving_proto_field_name=True)
    identity, poses = fields.pop("identity", {}), fields.pop("pose", {})
    category = storage.WhichOneof("category")
    entry: dict[str, Any] = {"number": identity.get("no", ""), "id": identity.get("id", 0)}
    entry["type"] = category or _BASE
    dock, real = (_numbers(poses.pop(key, None)) for key in ("dock", "real"))
    if dock:
        entry["pose"] = dock
    if real and real != dock:
        entry["real"] = real
    if identity.get("desc"):
        entry["description"] = identity["desc"]
    if category and not fields[category]:
        del fields[category]
    if poses:
        fields["pose"] = poses
    if fields:
        entry["details"] = fields
    return entry


def _storage(node: Node) -> Storage:
    """Return the mark that an entry of the file describes."""
    node.check_keys(("number", "id", "type", "pose", "real", "description", "details"))
    details = node.get("details")
    storage = _parsed(details, Storage()) if details else Storage()
    id_, description, kind = node.get("id"), node.get("description"), node.get("type")
    storage.identity.no = node.required("number").text()
    storage.identity.id = id_.integer(0, _UINT32) if id_ else 0
    storage.identity.desc = description.text() if description else ""
    category = kind.choice((_BASE, *_TYPES)) if kind else _BASE
    given = storage.WhichOneof("category")
    if given and given != category:
        raise node.error(f"details are those of a {given}, but type is {category}")
    if category != _BASE:
        getattr(storage, category).SetInParent()
    pose, real = node.get("pose"), node.get("real")
    if not pose and not real:
        raise node.error("pose is missing")
    for target, source in ((storage.pose.dock, pose), (storage.pose.real, real or pose)):
        if source:
            target.x, target.y, target.theta = source.numbers("x, y, theta")
            target.SetInParent()
    return storage


def _others(info: MarkInfo) -> dict[str, Any]:
    """Return everything but the storage places, as in the file."""
    fields = MessageToDict(info, preserving_proto_field_name=True)
    return {key: value for key, value in fields.items() if key not in ("storages", "version")}


def _parsed(node: Node, message: Any) -> Any:
    """Add the fields in a part of the file to a message, and return it."""
    try:
        return ParseDict(node.value, message)
    except (ParseError, TypeError, ValueError, AttributeError) as error:
        raise node.error(f"does not fit {message.DESCRIPTOR.full_name}: {error}") from None


def _numbers(pose: dict[str, float] | None) -> list[float] | None:
    return None if pose is None else [float(pose.get(key, 0.0)) for key in ("x", "y", "theta")]
