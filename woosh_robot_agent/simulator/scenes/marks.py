"""Marks as protobuf messages, and back."""

from __future__ import annotations

from collections.abc import Iterable

from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map, Mark, MarkKind

_CATEGORIES = {kind: kind.value.removesuffix("s") for kind in MarkKind}
"""Field of `woosh.map.mark.Storage` that is set for each kind; a base has none."""

_KINDS = {category: kind for kind, category in _CATEGORIES.items()}
"""Kind of a mark by the field that is set."""


def has_pose(storage: mark_pb2.Storage) -> bool:
    """Return True if the data of a mark say where it is."""
    return storage.pose.HasField("dock") or storage.pose.HasField("real")


def mark_of(storage: mark_pb2.Storage) -> Mark:
    """Return the mark that a message describes. It keeps a reference to the message."""
    pose = storage.pose.dock if storage.pose.HasField("dock") else storage.pose.real
    return Mark(
        id=storage.identity.id,
        number=storage.identity.no,
        pose=Pose(pose.x, pose.y, pose.theta),
        kind=_KINDS[storage.WhichOneof("category") or _CATEGORIES[MarkKind.BASE]],
        description=storage.identity.desc,
        storage=storage,
    )


def storage_of(mark: Mark) -> mark_pb2.Storage:
    """Return all data of a mark, as a new message."""
    storage = mark_pb2.Storage()
    if mark.storage is not None:
        storage.CopyFrom(mark.storage)
        return storage
    pose = common_pb2.Pose2D(x=mark.pose.x, y=mark.pose.y, theta=mark.pose.theta)
    storage.identity.CopyFrom(mark_pb2.Identity(id=mark.id, no=mark.number, desc=mark.description))
    storage.pose.CopyFrom(mark_pb2.Pose(dock=pose, real=pose))
    if mark.kind is not MarkKind.BASE:
        getattr(storage, _CATEGORIES[mark.kind]).SetInParent()
    return storage


def storages_of(marks: Iterable[Mark]) -> mark_pb2.Storages:
    """Return marks by category."""
    groups = mark_pb2.Storages()
    for mark in marks:
        storage = storage_of(mark)
        getattr(groups, mark.kind.value).add(
            identity=storage.identity, pose=storage.pose, custom=storage.custom
        )
    return groups


def mark_info_of(area: Map) -> mark_pb2.MarkInfo:
    """Return all marks of a map, as a new message."""
    info = mark_pb2.MarkInfo()
    info.CopyFrom(area.other_marks)
    info.version = area.version
    info.floor_name = area.floor
    info.storages.extend(storage_of(mark) for mark in area.marks.values())
    return info


def marks_of(info: mark_pb2.MarkInfo) -> dict[str, Mark]:
    """Return the storage places in a message, by number."""
    return {storage.identity.no: mark_of(storage) for storage in info.storages}


def other_marks(info: mark_pb2.MarkInfo) -> mark_pb2.MarkInfo:
    """Return the marks that are no storage places, as a new message."""
    others = mark_pb2.MarkInfo()
    others.CopyFrom(info)
    for name in ("version", "floor_name", "storages"):
        others.ClearField(name)
    return others
