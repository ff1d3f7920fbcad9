"""A scene: the maps of a site with their marks, the tasks of the site, and the scene's files.

A robot keeps a scene in a folder. The simulator serves and accepts the same files:

    scene.json              the maps, each with the pose at which the robot was last
    action_groups.json      the actions of which the tasks consist
    task_info.data          the task sets: a serialised `woosh.task.TaskInfo`
    MAP/map.yaml, map.png   the picture of the map and where it lies
    MAP/keepout.png         the areas that navigation keeps out of
    MAP/mark_info.data      the marks: a serialised `woosh.map.mark.MarkInfo`
    MAP/nav_area.data, MAP/path_info.data, MAP/traffic_keepout.png and others: carried unchanged

A `woosh.map.mark.Storage` (a storage place) is what a task can have as its target. This package
calls it a mark.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

import yaml

from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator.scenes.action_groups import (
    ACTION_GROUPS,
    ActionGroups,
    default_action_groups,
)
from woosh_robot_agent.simulator.timeline import copy_of
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map, Mark, MarkKind


@dataclass
class Scene:
    """The maps of a site and the tasks that are defined there.

    Attributes:
        name: name, unique among the scenes.
        maps: at least one map. The first one is the default.
        files: files of the scene as they were read or uploaded, by path, without the one of
            `action_groups`. A change of the scene removes outdated files, and `files_of` creates
            missing files.
        start: initial pose of the robot on `start_map`; None for any free place.
        start_map: name of the map on which the robot starts; empty for the first map.
        predefined: task sets that ExecPreTask can start.
        calls: task sets that call buttons start.
        action_groups: the actions of which tasks consist.
    """

    name: str
    maps: list[Map]
    files: dict[str, bytes] = field(default_factory=dict)
    start: Pose | None = None
    start_map: str = ""
    predefined: woosh_task_pb2.RepeatTasks = field(default_factory=woosh_task_pb2.RepeatTasks)
    calls: woosh_task_pb2.CallTasks = field(default_factory=woosh_task_pb2.CallTasks)
    action_groups: ActionGroups = field(default_factory=default_action_groups)

    def map(self, name: str) -> Map | None:
        """Return the map called `name`; the first map if `name` is empty; None if there is none."""
        if not name:
            return self.maps[0]
        return next((each for each in self.maps if each.name == name), None)


def has_pose(storage: mark_pb2.Storage) -> bool:
    """Return True if the data of a mark contain a pose."""
    return storage.pose.HasField("dock") or storage.pose.HasField("real")


def mark_of(storage: mark_pb2.Storage) -> Mark:
    """Return the mark that a message describes. The mark keeps a reference to the message."""
    # Prefer the pose of a robot that docks there to the pose of the place itself.
    pose = storage.pose.dock if storage.pose.HasField("dock") else storage.pose.real
    return Mark(
        id=storage.identity.id,
        number=storage.identity.no,
        pose=Pose(pose.x, pose.y, pose.theta),
        kind=MarkKind(storage.WhichOneof("category") or MarkKind.BASE),
        description=storage.identity.desc,
        storage=storage,
    )


def storage_of(mark: Mark) -> mark_pb2.Storage:
    """Return the Storage message with all data of a mark, as a new message."""
    if mark.storage is not None:
        return copy_of(mark.storage)
    storage = mark_pb2.Storage()
    pose = common_pb2.Pose2D(x=mark.pose.x, y=mark.pose.y, theta=mark.pose.theta)
    storage.identity.CopyFrom(mark_pb2.Identity(id=mark.id, no=mark.number, desc=mark.description))
    storage.pose.CopyFrom(mark_pb2.Pose(dock=pose, real=pose))
    if mark.kind is not MarkKind.BASE:
        getattr(storage, mark.kind.value).SetInParent()  # selects it in the oneof `category`
    return storage


def storages_of(marks: Iterable[Mark]) -> mark_pb2.Storages:
    """Return the data of marks, grouped by kind."""
    groups = mark_pb2.Storages()
    for mark in marks:
        storage = storage_of(mark)
        getattr(groups, f"{mark.kind.value}s").add(
            identity=storage.identity, pose=storage.pose, custom=storage.custom
        )
    return groups


def mark_info_of(area: Map) -> mark_pb2.MarkInfo:
    """Return all marks of a map, as a new message in the form of its file."""
    info = copy_of(area.other_marks)
    info.version = area.version
    info.floor_name = area.floor
    info.storages.extend(storage_of(mark) for mark in area.marks.values())
    return info


def marks_of(info: mark_pb2.MarkInfo) -> dict[str, Mark]:
    """Return the marks in a message that tasks can have as targets, by number."""
    return {storage.identity.no: mark_of(storage) for storage in info.storages}


def other_marks(info: mark_pb2.MarkInfo) -> mark_pb2.MarkInfo:
    """Return the marks that the robot only stores, such as beacons, as a new message."""
    others = copy_of(info)
    for name in ("version", "floor_name", "storages"):
        others.ClearField(name)
    return others


_MAX_ID = 2**32 - 1
"""Greatest possible id of a map or mark."""


def with_map(scene: Scene, area: Map) -> Scene:
    """Return a scene with an additional map, or with a map that replaces the one of its name.

    A new map gets a free id. A map that replaces another one gets the other's id and floor, a
    version above the other's, and, if it has no `marks`, all marks of the other.
    """
    old = scene.map(area.name)
    if old is None:
        number = free_id(each.id for each in scene.maps)
        # Without the index, which does not list the new map: `files_of` creates a new one.
        files = {name: data for name, data in scene.files.items() if name != SCENE_INDEX}
        return replace(scene, maps=[*scene.maps, replace(area, id=number)], files=files)
    newer = replace(
        area,
        id=old.id,
        floor=old.floor,
        version=max(area.version, old.version + 1),
        marks=area.marks or old.marks,
        other_marks=area.other_marks if area.marks else old.other_marks,
    )
    return with_map_changed(scene, old, newer)


def without_map(scene: Scene, area: Map) -> Scene:
    """Return a scene without one of its maps, and without the start if that is on this map."""
    maps = [each for each in scene.maps if each is not area]
    # Also without the index, which lists the map: `files_of` creates a new one.
    files = {
        name: data
        for name, data in scene.files.items()
        if name != SCENE_INDEX and not name.startswith(f"{area.name}/")
    }
    newer = replace(scene, maps=maps, files=files)
    if area is scene.map(scene.start_map):
        newer.start_map, newer.start = "", None
    return newer


def with_map_renamed(scene: Scene, area: Map, name: str) -> Scene:
    """Return a scene in which one map has another name."""
    newer = replace(area, name=name, version=area.version + 1)
    start_map = name if scene.start_map == area.name else scene.start_map
    return replace(with_map_changed(scene, area, newer), start_map=start_map)


def free_id(taken: Iterable[int]) -> int:
    """Return the highest id plus 1, or the first free id if the highest one is `_MAX_ID`."""
    ids = set(taken)
    highest = max(ids, default=0)
    return highest + 1 if highest < _MAX_ID else next(n for n in count(1) if n not in ids)


def with_map_changed(scene: Scene, old: Map, new: Map) -> Scene:
    """Return a scene with the map `new` in place of `old`, and without the outdated files."""
    outdated: set[str] = set()
    if mark_info_of(new) != mark_info_of(old):
        outdated.add(f"{old.name}/{MARK_INFO}")
    if (new.id, new.name, new.end) != (old.id, old.name, old.end):
        outdated.add(SCENE_INDEX)
    if not new.same_ground(old):
        outdated |= {f"{old.name}/{each}" for each in (*PICTURES, TRAFFIC_KEEPOUT)}
    files: dict[str, bytes] = {}
    for name, data in scene.files.items():
        if name in outdated:
            continue
        folder, _, file = name.partition("/")
        is_of_map = file and folder == old.name
        files[f"{new.name}/{file}" if is_of_map else name] = data
    maps = [new if each is old else each for each in scene.maps]
    return replace(scene, maps=maps, files=files)


def set_predefined(scene: Scene, sets: Iterable[woosh_task_pb2.RepeatTask]) -> None:
    """Replace the task sets that ExecPreTask can start, in the given scene itself."""
    scene.predefined = woosh_task_pb2.RepeatTasks(repeat_tasks=sets)
    scene.files.pop(TASK_INFO, None)


SCENE_INDEX = "scene.json"
"""Name of the file that lists the maps of a scene."""

TASK_INFO = "task_info.data"
"""Name of the file with the task sets of a scene."""

MAP_FILE, PICTURE, KEEPOUT = "map.yaml", "map.png", "keepout.png"
PICTURES = (MAP_FILE, PICTURE, KEEPOUT)
"""Names of the files of a map that depend on its cells."""

TRAFFIC_KEEPOUT = "traffic_keepout.png"
"""Name of the file with the areas that traffic control keeps out of. The robot does not use it."""

MARK_INFO = "mark_info.data"
"""Name of the file with the marks of a map."""

NAV_AREA, PATH_INFO = "nav_area.data", "path_info.data"
"""Names of the files with the fields and the guide paths of a map."""

MAX_NAME = 255
"""Maximum length of a plain name, in characters."""


def is_plain(name: str) -> bool:
    """Return True if a name is a valid file name, not a path, on every operating system."""
    plain = PurePosixPath(name).name == PureWindowsPath(name).name == name
    return plain and name not in ("", "..") and name.isprintable() and len(name) <= MAX_NAME


@dataclass(frozen=True)
class SceneFiles:
    """The files of a scene.

    Attributes:
        shared: files that belong to no map, by path.
        of_maps: files of each map by path, by the map's name.
    """

    shared: dict[str, bytes]
    of_maps: dict[str, dict[str, bytes]]

    @property
    def all(self) -> dict[str, bytes]:
        """All files, by path."""
        files = dict(self.shared)
        for each in self.of_maps.values():
            files.update(each)
        return files


def files_of(scene: Scene) -> SceneFiles:
    """Return all files of a scene: the stored files, and new files in place of missing ones."""
    of_maps = {area.name: _missing_files(area, scene.files) for area in scene.maps}
    shared: dict[str, bytes] = {}
    for name, data in scene.files.items():
        folder, _, _ = name.partition("/")
        files = of_maps.get(folder, shared)
        files[name] = data
    if SCENE_INDEX not in shared:
        shared[SCENE_INDEX] = _index(scene)
    shared[ACTION_GROUPS] = scene.action_groups.data
    if TASK_INFO not in shared:
        shared[TASK_INFO] = task_info_of(scene).SerializeToString(deterministic=True)
    return SceneFiles(shared, of_maps)


def task_info_of(scene: Scene) -> woosh_task_pb2.TaskInfo:
    """Return all task sets of a scene, as a new message."""
    return woosh_task_pb2.TaskInfo(
        repeat_tasks=scene.predefined.repeat_tasks, call_tasks=scene.calls.call_tasks
    )


def end_of(scene: Scene, area: Map) -> Pose | None:
    """Return the pose at which the robot was last on a map, or else its start there, or None."""
    starts_here = area is scene.map(scene.start_map)
    return area.end or (scene.start if starts_here else None)


def _index(scene: Scene) -> bytes:
    """Return the file that lists the maps of a scene."""
    maps: list[dict[str, Any]] = []
    for area in scene.maps:
        entry: dict[str, Any] = {"id": area.id, "name": area.name}
        if end := end_of(scene, area):
            entry["end_pose"] = {"x": end.x, "y": end.y, "theta": end.theta}
        maps.append(entry)
    return (json.dumps({"maps": maps}, indent=2, ensure_ascii=False) + "\n").encode()


def _missing_files(area: Map, given: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return new files for a map, by path, in place of those that are not in `given`."""
    files: dict[str, bytes] = {}
    picture, folder = f"{area.name}/{PICTURE}", f"{area.name}/"
    if picture not in given:
        # numpy and Pillow load slowly, and only pictures need them.
        from woosh_robot_agent.simulator.world.picture import draw

        drawn = draw(area)
        description = {
            "image": PICTURE,
            "resolution": drawn.resolution,
            "origin": [*drawn.low, 0],
        }
        files[folder + MAP_FILE] = yaml.safe_dump(description, sort_keys=False).encode()
        files[picture] = drawn.png
        if drawn.keepout:
            files[folder + KEEPOUT] = drawn.keepout
    if folder + MARK_INFO not in given:
        files[folder + MARK_INFO] = mark_info_of(area).SerializeToString(deterministic=True)
    return files
