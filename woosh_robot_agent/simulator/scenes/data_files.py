"""Reads the files of a scene that are serialised protobuf messages: its tasks and its marks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from google.protobuf.message import DecodeError, Message

from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.simulator.scenes.marks import has_pose
from woosh_robot_agent.simulator.yaml_fields import DataFileError

Read = Callable[[str], bytes]
"""Returns the content of the file with the given name, or raises `DataFileError`."""

TASK_INFO = "task_info.data"
"""Name of the file with the tasks of a scene, a `woosh.task.TaskInfo`."""

MARK_INFO = ".mark_info.data"
"""End of the name of a file with the marks of a map, a `woosh.map.mark.MarkInfo`."""

MAX_MARKS = 5000
"""Maximum number of marks of a map."""

MAX_TASKS = 200
"""Maximum number of task sets of one kind, and of tasks in a set."""

_M = TypeVar("_M", bound=Message)
"""Class of the message in a file."""


def read_task_info(name: str, read: Read) -> woosh_task_pb2.TaskInfo:
    """Read a file with the tasks of a scene.

    Raises:
        DataFileError: The file cannot be used.
    """
    info = _message(name, read, woosh_task_pb2.TaskInfo)
    counts = [len(info.repeat_tasks), len(info.call_tasks)]
    counts += [len(each.task_set.tasks) for each in info.repeat_tasks]
    counts += [len(each.task_set.tasks) for each in info.call_tasks]
    if max(counts) > MAX_TASKS:
        raise DataFileError(f"{name}: {max(counts)} tasks are more than {MAX_TASKS}")
    return info


def read_mark_info(name: str, read: Read) -> mark_pb2.MarkInfo:
    """Read a file with the marks of a map.

    Raises:
        DataFileError: The file cannot be used.
    """
    info = _message(name, read, mark_pb2.MarkInfo)
    if len(info.storages) > MAX_MARKS:
        raise DataFileError(f"{name}: {len(info.storages)} marks are more than {MAX_MARKS}")
    numbers: set[str] = set()
    ids: set[int] = set()
    for index, storage in enumerate(info.storages):
        where, identity = f"{name}: storages[{index}]", storage.identity
        if not identity.no:
            raise DataFileError(f"{where}: identity.no is missing")
        if identity.no in numbers or identity.id in ids:
            raise DataFileError(
                f"{where}: its number {identity.no} or id {identity.id} is used twice"
            )
        if not has_pose(storage):
            raise DataFileError(f"{where}: pose.dock is missing")
        for pose in (storage.pose.dock, storage.pose.real):
            if not all(map(math.isfinite, (pose.x, pose.y, pose.theta))):
                raise DataFileError(f"{where}: the pose is not finite")
        numbers.add(identity.no)
        ids.add(identity.id)
    return info


def _message(name: str, read: Read, cls: type[_M]) -> _M:
    try:
        return cls.FromString(read(name))
    except DecodeError as error:
        text = f"{name}: not a serialised {cls.DESCRIPTOR.full_name}: {error}"
        raise DataFileError(text) from error
