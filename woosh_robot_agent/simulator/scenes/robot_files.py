"""Read the files of a scene as robots keep them; `scenes.scene` describes these files."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, TypeVar

from google.protobuf.message import DecodeError, Message

from woosh_robot_agent.data_files import (
    Between,
    DataFileError,
    load_json,
    load_yaml,
    source_field,
    structure,
)
from woosh_robot_agent.pb.map import field_pb2, mark_pb2, path_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.simulator.scenes.action_groups import ACTION_GROUPS, read_action_groups
from woosh_robot_agent.simulator.scenes.scene import (
    KEEPOUT,
    MAP_FILE,
    MARK_INFO,
    NAV_AREA,
    PATH_INFO,
    PICTURES,
    SCENE_INDEX,
    TASK_INFO,
    Scene,
    files_of,
    has_pose,
    is_plain,
    marks_of,
    other_marks,
)
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map

if TYPE_CHECKING:  # numpy and scipy load slowly, and few maps have a grid
    from woosh_robot_agent.simulator.world.grid import Grid, KeepOut

FileReader = Callable[[str], bytes]
"""Returns the content of the file with the given name, or raises `DataFileError`."""

MAX_MAPS = 50
"""Maximum number of maps of a scene."""

MAX_MARKS = 5000
"""Maximum number of marks of a map."""

MAX_TASKS = 200
"""Maximum number of predefined task sets, of sets of call buttons, and of tasks in a set."""

_MAX_PIXELS = 32 * 1024 * 1024
"""Maximum number of pixels of all maps of a scene. Reading pictures blocks the simulator."""

_MAX_SIDE = 500.0
"""Maximum length of a side of a map, in metres."""

DEFAULT_FLOOR = "1F"
"""Floor of a map that names no floor."""

INT32 = 2**31 - 1
"""Largest value of an int32 field."""


@dataclass(frozen=True)
class _EndPose:
    """Last pose of the robot on a map, in metres and radians."""

    x: float
    y: float
    theta: float


def check_map_name(name: str) -> None:
    """Raise ValueError if a name cannot be the name of a map and of its folder."""
    if not is_plain(name):
        raise ValueError(f"{name!r} must be a name that is not a path")


@dataclass(frozen=True)
class _MapEntry:
    """A map in the index of a scene.

    Attributes:
        name: name of the map and of its folder.
        end_pose: last pose of the robot on the map; None if the index gives none.
        source: place of the entry in the index, for errors; not a key of the file.
    """

    id: Annotated[int, Between(0, 2**32 - 1)]
    name: Annotated[str, check_map_name]
    end_pose: _EndPose | None = None
    source: str = source_field()


@dataclass(frozen=True)
class _Index:
    """The index of a scene."""

    maps: Annotated[tuple[_MapEntry, ...], Between(1, MAX_MAPS)]


def read_robot_scene(name: str, files: Mapping[str, bytes], old: Scene | None = None) -> Scene:
    """Read a scene from its files. The robot starts at the first `end_pose` in the index.

    Args:
        files: all files of the scene, by path; the index must be among them.
        old: the scene before a change; None for a new scene. A map whose pictures have not changed
            keeps its walls and its grid: read from pictures, it would have a grid only.
    """
    entries = _index(files[SCENE_INDEX]).maps
    check_unique([each.source for each in entries], "name", [each.name for each in entries])
    check_unique([each.source for each in entries], "id", [each.id for each in entries])
    scene = Scene(name, [], files={**files})
    scene.action_groups = read_action_groups(scene.files.pop(ACTION_GROUPS, b""))
    old_files = files_of(old).of_maps if old else {}
    for entry in entries:
        known = old.map(entry.name) if old else None
        if known and _same_pictures(entry.name, files, old_files[entry.name]):
            scene.maps.append(_with_marks(entry, files, known))
        else:
            scene.maps.append(_map(entry, files))
            check_pixels(entry.source, scene.maps)
        if entry.end_pose and not scene.start:
            scene.start, scene.start_map = scene.maps[-1].end, entry.name
    info = read_task_info(files)
    scene.predefined.repeat_tasks.extend(info.repeat_tasks)
    scene.calls.call_tasks.extend(info.call_tasks)
    return scene


def map_names(index: bytes) -> list[str]:
    """Return the names of the maps in the index of a scene, which are also names of folders."""
    return [each.name for each in _index(index).maps]


def _index(data: bytes) -> _Index:
    return structure(_Index, load_json(SCENE_INDEX, data), SCENE_INDEX, known_only=False)


def _same_pictures(name: str, files: Mapping[str, bytes], before: Mapping[str, bytes]) -> bool:
    """Return True if the pictures of the map called `name` have not changed."""
    paths = [f"{name}/{each}" for each in PICTURES]
    return all(files.get(path) == before.get(path) for path in paths)


def _map(entry: _MapEntry, files: Mapping[str, bytes]) -> Map:
    """Read one map from the files of its scene."""
    grid = read_map_picture(entry.name, files)
    grid.keep_out = read_map_keepout(entry.name, files, grid)
    check_sides(entry.source, grid.low, grid.high)
    area = Map(entry.id, entry.name, "", 1, grid.low, grid.high, walls=(), grid=grid)
    return _with_marks(entry, files, area)


def read_map_picture(name: str, files: Mapping[str, bytes]) -> Grid:
    """Read the cells of the map called `name` from the files of its scene, without keep-out."""
    path = f"{name}/{MAP_FILE}"

    def read(file: str) -> bytes:
        file_path = f"{name}/{file}"
        if file_path not in files:
            raise DataFileError(f"{file_path}: the file of map {name} is missing")
        return files[file_path]

    # numpy, scipy and Pillow load in a third of a second, which only pictures need.
    from woosh_robot_agent.simulator.scenes.map_server import read_grid

    return read_grid(path, load_yaml(path, read(MAP_FILE)), read)


def read_map_keepout(name: str, files: Mapping[str, bytes], grid: Grid) -> KeepOut | None:
    """Read the keep-out cells of the map called `name`; None if their file is missing or empty."""
    # As in `read_map_picture`: numpy, scipy and Pillow load slowly.
    from woosh_robot_agent.simulator.scenes.map_server import read_keepout

    path = f"{name}/{KEEPOUT}"
    return read_keepout(path, files[path], grid) if files.get(path) else None


def _with_marks(entry: _MapEntry, files: Mapping[str, bytes], area: Map) -> Map:
    """Return a map with the marks in its files, and the properties in its entry of the index."""
    info, end = read_mark_info(entry.name, files), entry.end_pose
    check_unused_files(entry.name, files)
    return dataclasses.replace(
        area,
        id=entry.id,
        floor=info.floor_name or DEFAULT_FLOOR,
        version=min(max(1, info.version), INT32),
        marks=marks_of(info),
        other_marks=other_marks(info),
        end=Pose(end.x, end.y, end.theta) if end else None,
    )


def check_unused_files(name: str, files: Mapping[str, bytes]) -> None:
    """Check the files of a map that the robot does not use, but sends in SceneData."""
    _read_message(f"{name}/{NAV_AREA}", files, field_pb2.FieldInfo)
    _read_message(f"{name}/{PATH_INFO}", files, path_pb2.PathInfo)


def check_pixels(where: str, maps: Iterable[Map]) -> None:
    """Refuse too many pixels of all maps so far; `where` is the last map's place, for errors."""
    if sum(each.grid.cells.size for each in maps if each.grid) > _MAX_PIXELS:
        text = f"the pictures of the scene have more than {_MAX_PIXELS} pixels in total"
        raise DataFileError(f"{where}: {text}")


def check_sides(where: str, low: Sequence[float], high: Sequence[float]) -> None:
    """Refuse an empty or too large map, by its corners; `where` is its place, for errors."""
    for least, most in zip(low, high, strict=True):
        if not 0.0 < most - least <= _MAX_SIDE:
            text = f"a side of {most - least:g} m is not within 0 to {_MAX_SIDE:g} m"
            raise DataFileError(f"{where}: {text}")


def check_unique(places: Sequence[str], key: str, values: Sequence[Hashable]) -> None:
    """Check that all values of a key are different.

    Args:
        places: place of each value in the file, for the error.
    """
    seen = set()
    for where, value in zip(places, values, strict=True):
        if value in seen:
            raise DataFileError(f"{where}: {key} {value} is used twice")
        seen.add(value)


_M = TypeVar("_M", bound=Message)
"""Class of the message in a file."""


def read_task_info(files: Mapping[str, bytes]) -> woosh_task_pb2.TaskInfo:
    """Read the task sets of a scene from its files."""
    info = _read_message(TASK_INFO, files, woosh_task_pb2.TaskInfo)
    counts = [len(info.repeat_tasks), len(info.call_tasks)]
    counts += [len(each.task_set.tasks) for each in info.repeat_tasks]
    counts += [len(each.task_set.tasks) for each in info.call_tasks]
    if max(counts) > MAX_TASKS:
        text = f"{max(counts)} task sets, or tasks in a set, are more than {MAX_TASKS}"
        raise DataFileError(f"{TASK_INFO}: {text}")
    return info


def read_mark_info(name: str, files: Mapping[str, bytes]) -> mark_pb2.MarkInfo:
    """Read the marks of the map called `name` from the files of its scene."""
    path = f"{name}/{MARK_INFO}"
    info = _read_message(path, files, mark_pb2.MarkInfo)
    if len(info.storages) > MAX_MARKS:
        raise DataFileError(f"{path}: {len(info.storages)} marks are more than {MAX_MARKS}")
    places = [f"{path}: storages[{index}]" for index in range(len(info.storages))]
    for where, storage in zip(places, info.storages, strict=True):
        if not storage.identity.no:
            raise DataFileError(f"{where}: identity.no is missing")
        if not has_pose(storage):
            raise DataFileError(f"{where}: pose.dock is missing")
        for pose in (storage.pose.dock, storage.pose.real):
            if not all(map(math.isfinite, (pose.x, pose.y, pose.theta))):
                raise DataFileError(f"{where}: the pose is not finite")
    check_unique(places, "identity.no", [each.identity.no for each in info.storages])
    check_unique(places, "identity.id", [each.identity.id for each in info.storages])
    return info


def _read_message(path: str, files: Mapping[str, bytes], cls: type[_M]) -> _M:
    """Read a serialised message; the message is empty if the file is empty or missing."""
    try:
        return cls.FromString(files.get(path, b""))
    except DecodeError as error:
        text = f"{path}: not a serialised {cls.DESCRIPTOR.full_name}: {error}"
        raise DataFileError(text) from error
