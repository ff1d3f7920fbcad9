"""Handlers of requests about the marks of the current map: find, list and edit."""

from __future__ import annotations

from google.protobuf.message import Message

from woosh_robot_agent.pb.map import mark_pb2, storage_edit_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import command, named_mark, query
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.robot_files import MAX_MARKS
from woosh_robot_agent.simulator.scenes.scene import (
    free_id,
    has_pose,
    mark_of,
    storage_of,
    storages_of,
    with_marks,
)
from woosh_robot_agent.simulator.timeline import copy_of
from woosh_robot_agent.simulator.world.maps import Mark

_MAX_NUMBER = 100
"""Maximum length of the number of a mark, in characters."""

_MAX_MARK = 4096
"""Maximum size of the data of a mark, in bytes."""


@query(storage_edit_pb2.Find)
def _find(chassis: Chassis, request: storage_edit_pb2.Find) -> Message:
    return storage_of(named_mark(chassis, request.no))


@query(storage_edit_pb2.Storages)
def _storages(chassis: Chassis, request: storage_edit_pb2.Storages) -> Message:
    return storages_of(chassis.map.marks.values())


@command(storage_edit_pb2.Create)
def _create(chassis: Chassis, request: storage_edit_pb2.Create) -> Message:
    area, storage = chassis.map, copy_of(request.storage)  # a copy: tests read the request as sent
    if len(area.marks) >= MAX_MARKS:
        raise RefusedError(f"map {area.name} has {MAX_MARKS} marks already: delete one first")
    if storage.identity.no in area.marks:
        raise RefusedError(
            f"mark {storage.identity.no} of map {area.name} exists already: choose another "
            "number, or update it"
        )
    if not storage.identity.id:
        storage.identity.id = free_id(mark.id for mark in area.marks.values())
    mark = _checked(chassis, storage)
    _store(chassis, [*area.marks.values(), mark])
    return storage_of(mark)


@command(storage_edit_pb2.Update)
def _update(chassis: Chassis, request: storage_edit_pb2.Update) -> None:
    """Change the mark with the given number; if no mark has it, renumber the mark with the id."""
    area, changes = chassis.map, request.storage
    number, id_ = changes.identity.no, changes.identity.id
    by_id = next((mark for mark in area.marks.values() if id_ and mark.id == id_), None)
    old = area.marks.get(number) or by_id or named_mark(chassis, number)
    storage = storage_of(old)
    # A given field replaces the old one, and a given category replaces another category.
    for field, _ in changes.ListFields():
        if field.containing_oneof:
            storage.ClearField(storage.WhichOneof(field.containing_oneof.name) or field.name)
        else:
            storage.ClearField(field.name)
    storage.MergeFrom(changes)
    storage.identity.id = id_ or old.id
    mark = _checked(chassis, storage, old)
    _store(chassis, [mark if each is old else each for each in area.marks.values()])


@command(storage_edit_pb2.Delete)
def _delete(chassis: Chassis, request: storage_edit_pb2.Delete) -> None:
    old = named_mark(chassis, request.no)
    _store(chassis, [each for each in chassis.map.marks.values() if each is not old])


def _checked(chassis: Chassis, storage: mark_pb2.Storage, old: Mark | None = None) -> Mark:
    """Check the mark that a client has described, and return it.

    Args:
        chassis: the robot, on whose current map the mark is.
        old: the mark that it replaces, None for a new mark.

    Raises:
        RefusedError: the mark cannot be on this map.
    """
    area, number = chassis.map, storage.identity.no
    if not number:
        raise RefusedError("the mark has no number: set identity.no")
    if len(number) > _MAX_NUMBER:
        raise RefusedError(refusals.TEXT_TOO_LONG, field="identity.no", limit=_MAX_NUMBER)
    if storage.ByteSize() > _MAX_MARK:
        raise RefusedError(
            f"the data of mark {number} have {storage.ByteSize()} bytes, more than "
            f"{_MAX_MARK}: send fewer"
        )
    if not has_pose(storage):
        raise RefusedError(f"mark {number} has no pose: set pose.dock")
    for other in area.marks.values():
        if other is not old and other.id == storage.identity.id:
            raise RefusedError(
                f"mark {other.number} of map {area.name} has the id {other.id} already: use 0 "
                "for a free one"
            )
    mark = mark_of(storage)
    if not area.contains(*mark.pose.point):
        raise RefusedError(f"mark {number} is outside map {area.name}: choose a pose inside")
    return mark


def _store(chassis: Chassis, marks: list[Mark]) -> None:
    chassis.replace_scene(chassis.scene, with_marks(chassis.scene, chassis.map, marks))
