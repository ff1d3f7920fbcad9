"""Handlers of the commands that create, change and delete marks of the current map."""

from __future__ import annotations

from woosh_robot_agent.pb.map import mark_pb2, storage_edit_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import (
    Handlers,
    Result,
    named_mark,
    require_inside,
)
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.data_files import MAX_MARKS
from woosh_robot_agent.simulator.scenes.editing import free_mark_id, with_marks
from woosh_robot_agent.simulator.scenes.marks import has_pose, mark_of, storage_of
from woosh_robot_agent.simulator.world.maps import Mark

_MAX_NUMBER = 100
"""Maximum length of the number of a mark, in characters."""

_MAX_BYTES = 4096
"""Maximum size of the data of a mark, in bytes."""


def _create(chassis: Chassis, request: storage_edit_pb2.Create) -> Result:
    area, storage = chassis.map, mark_pb2.Storage()
    storage.CopyFrom(request.storage)  # the request is kept as it came
    if len(area.marks) >= MAX_MARKS:
        raise RefusedError(refusals.TOO_MANY_MARKS, map=area.name, limit=MAX_MARKS)
    if storage.identity.no in area.marks:
        raise RefusedError(refusals.MARK_EXISTS, mark=storage.identity.no, map=area.name)
    if not storage.identity.id:
        storage.identity.id = free_mark_id(area)
    mark = _checked(chassis, storage)
    _store(chassis, [*area.marks.values(), mark])
    return storage_of(mark)


def _update(chassis: Chassis, request: storage_edit_pb2.Update) -> Result:
    """Change the mark with the given number, or else give the mark with that id a new number."""
    area, changes = chassis.map, request.storage
    number, id_ = changes.identity.no, changes.identity.id
    by_id = next((mark for mark in area.marks.values() if id_ and mark.id == id_), None)
    old = area.marks.get(number) or by_id or named_mark(chassis, number)
    storage = storage_of(old)
    for field, _ in changes.ListFields():
        if field.containing_oneof:
            storage.ClearField(storage.WhichOneof(field.containing_oneof.name) or field.name)
        else:
            storage.ClearField(field.name)
    storage.MergeFrom(changes)
    storage.identity.id = id_ or old.id
    mark = _checked(chassis, storage, old)
    _store(chassis, [mark if each is old else each for each in area.marks.values()])
    return None


def _delete(chassis: Chassis, request: storage_edit_pb2.Delete) -> Result:
    old = named_mark(chassis, request.no)
    _store(chassis, [each for each in chassis.map.marks.values() if each is not old])
    return None


def _checked(chassis: Chassis, storage: mark_pb2.Storage, old: Mark | None = None) -> Mark:
    """Return the mark that a client has described.

    Args:
        chassis: The robot, on whose current map the mark is.
        storage: Data of the mark.
        old: The mark that it replaces, None for a new one.

    Raises:
        RefusedError: The mark cannot be on this map.
    """
    area, number = chassis.map, storage.identity.no
    if not number:
        raise RefusedError(refusals.NO_MARK_NUMBER)
    if len(number) > _MAX_NUMBER:
        raise RefusedError(refusals.TEXT_TOO_LONG, field="identity.no", limit=_MAX_NUMBER)
    if storage.ByteSize() > _MAX_BYTES:
        raise RefusedError(
            refusals.MARK_TOO_LARGE, mark=number, size=storage.ByteSize(), limit=_MAX_BYTES
        )
    if not has_pose(storage):
        raise RefusedError(refusals.MARK_WITHOUT_POSE, mark=number)
    for other in area.marks.values():
        if other is not old and other.id == storage.identity.id:
            raise RefusedError(
                refusals.MARK_ID_EXISTS, mark=other.number, map=area.name, id=other.id
            )
    mark = mark_of(storage)
    require_inside(mark, area)
    return mark


def _store(chassis: Chassis, marks: list[Mark]) -> None:
    chassis.replace_scene(chassis.scene, with_marks(chassis.scene, chassis.map, marks))


HANDLERS: Handlers = {
    storage_edit_pb2.Create: _create,
    storage_edit_pb2.Update: _update,
    storage_edit_pb2.Delete: _delete,
}
