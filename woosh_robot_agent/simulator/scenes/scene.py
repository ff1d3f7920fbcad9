"""A scene: the maps of a site with their marks, its tasks, and the files that describe all this."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import count
from pathlib import PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Any

import yaml

from woosh_robot_agent.data_files import load_yaml
from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator.world.geometry import Pose, Wall
from woosh_robot_agent.simulator.world.maps import ImageFiles, Map, Mark, MarkKind

if TYPE_CHECKING:  # numpy and scipy load slowly, and few maps have a grid
    from woosh_robot_agent.simulator.world.grid import Grid


@dataclass
class Scene:
    """The maps of a site and the tasks that are defined there.

    Attributes:
        name: Name, unique among the scenes.
        maps: At least one map. The first one is the default.
        files: Files that clients uploaded and that describe neither map, mark nor task, by name.
        start: Initial pose of the robot on `start_map`; None if the scene does not define one.
        start_map: Name of the map on which the robot starts; empty for the first one.
        predefined: Task sets that ExecPreTask can start.
        calls: Task sets that call buttons start.
    """

    name: str
    maps: list[Map]
    files: dict[str, bytes] = field(default_factory=dict)
    start: Pose | None = None
    start_map: str = ""
    predefined: woosh_task_pb2.RepeatTasks = field(default_factory=woosh_task_pb2.RepeatTasks)
    calls: woosh_task_pb2.CallTasks = field(default_factory=woosh_task_pb2.CallTasks)

    def map(self, name: str) -> Map | None:
        """Return the map called `name`, the first map if `name` is empty, or None."""
        if not name:
            return self.maps[0]
        return next((each for each in self.maps if each.name == name), None)


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
        kind=MarkKind(storage.WhichOneof("category") or MarkKind.BASE),
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
        getattr(storage, mark.kind.value).SetInParent()
    return storage


def storages_of(marks: Iterable[Mark]) -> mark_pb2.Storages:
    """Return marks by category."""
    groups = mark_pb2.Storages()
    for mark in marks:
        storage = storage_of(mark)
        getattr(groups, f"{mark.kind.value}s").add(
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


_MAX_ID = 2**32 - 1
"""Greatest possible id of a map or mark."""


def with_map(scene: Scene, area: Map) -> Scene:
    """Return a scene with a map more, or with another one in place of the map of its name.

    A new map gets a free id. A map that replaces another one keeps its id, its floor, and if it has
    no marks the marks.
    """
    old = next((each for each in scene.maps if each.name == area.name), None)
    if old is None:
        number = _free_id(each.id for each in scene.maps)
        return replace(scene, maps=[*scene.maps, replace(area, id=number)])
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
    """Return a scene without one of its maps."""
    maps = [each for each in scene.maps if each is not area]
    if area is scene.map(scene.start_map):
        return replace(scene, maps=maps, start_map="", start=None)
    return replace(scene, maps=maps)


def with_map_renamed(scene: Scene, area: Map, name: str) -> Scene:
    """Return a scene in which one map has another name."""
    image = area.image
    if image and PurePosixPath(image.name).stem == area.name:
        image = _renamed(image, name)
    newer = replace(area, name=name, version=area.version + 1, image=image)
    start_map = name if scene.start_map == area.name else scene.start_map
    return replace(with_map_changed(scene, area, newer), start_map=start_map)


def _renamed(image: ImageFiles, stem: str) -> ImageFiles:
    """Return the files of a map under other names."""
    picture_name = stem + PurePosixPath(image.picture_name).suffix
    description = {**load_yaml(image.name, image.description), "image": picture_name}
    text = yaml.safe_dump(description, sort_keys=False, allow_unicode=True)
    return ImageFiles(f"{stem}.yaml", text.encode(), picture_name, image.picture)


def free_mark_id(area: Map) -> int:
    """Return an id that no mark of a map has."""
    return _free_id(mark.id for mark in area.marks.values())


def with_marks(scene: Scene, area: Map, marks: Iterable[Mark]) -> Scene:
    """Return a scene in which one map has other marks."""
    numbered = {mark.number: mark for mark in marks}
    return with_map_changed(scene, area, replace(area, version=area.version + 1, marks=numbered))


def _free_id(taken: Iterable[int]) -> int:
    """Return an id that follows all others, or the first free one if there is none after them."""
    ids = set(taken)
    highest = max(ids, default=0)
    return highest + 1 if highest < _MAX_ID else next(n for n in count(1) if n not in ids)


def with_map_changed(scene: Scene, old: Map, new: Map) -> Scene:
    """Return a scene with `new` in place of one of its maps."""
    return replace(scene, maps=[new if each is old else each for each in scene.maps])


TASK_INFO = "task_info.data"
"""Name of the file with the tasks of a scene, a `woosh.task.TaskInfo`."""

MARK_INFO = ".mark_info.data"
"""End of the name of a file with the marks of a map, a `woosh.map.mark.MarkInfo`."""

SCENE_FILE = "scene.yaml"
"""Name of the file that describes a scene."""

MAX_NAME = 255
"""Maximum length of a name, in characters."""


def is_plain(name: str) -> bool:
    """Return True if a name is not empty and is a file name, not a path, on every system."""
    plain = PurePosixPath(name).name == PureWindowsPath(name).name == name
    return plain and name not in ("", "..") and name.isprintable() and len(name) <= MAX_NAME


@dataclass(frozen=True)
class SceneFiles:
    """The files of a scene as `scenes.files` reads them, by name. All names are plain file names.

    Each map NAME has `NAME.mark_info.data`, and a map of map_server if it has a grid: a YAML file
    and a picture. The scene has `scene.yaml`, `task_info.data`, and the files that clients uploaded
    and that describe nothing.

    Attributes:
        shared: Files that belong to no map.
        of_maps: Files of each map, by the map's name.
    """

    shared: dict[str, bytes]
    of_maps: dict[str, dict[str, bytes]]

    @property
    def all(self) -> dict[str, bytes]:
        """All files."""
        files = dict(self.shared)
        for each in self.of_maps.values():
            files.update(each)
        return files


def files_of(scene: Scene) -> SceneFiles:
    """Return the files of a scene."""
    tasks = woosh_task_pb2.TaskInfo(
        repeat_tasks=scene.predefined.repeat_tasks, call_tasks=scene.calls.call_tasks
    )
    shared = {TASK_INFO: tasks.SerializeToString(deterministic=True)}
    taken = {SCENE_FILE, TASK_INFO}
    maps: list[dict[str, Any]] = []
    of_maps: dict[str, dict[str, bytes]] = {}
    for area in scene.maps:
        description, files = _map_files(area, taken)
        taken.update(files)
        maps.append(description)
        of_maps[area.name] = files
    root: dict[str, Any] = {"name": scene.name}
    if scene.start:
        start = scene.start
        root["start"] = {"pose": [start.x, start.y, start.theta]}
        if scene.start_map:
            root["start"]["map"] = scene.start_map
    root |= {"maps": maps, "task_info": TASK_INFO}
    text = yaml.safe_dump(root, sort_keys=False, allow_unicode=True, default_flow_style=None)
    shared[SCENE_FILE] = text.encode()
    shared.update((name, data) for name, data in scene.files.items() if name not in taken)
    return SceneFiles(shared, of_maps)


def _map_files(area: Map, taken: set[str]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return the description of a map for `scene.yaml`, and its files."""
    stem = area.name if is_plain(f"{area.name}{MARK_INFO}") else f"map-{area.id}"
    description: dict[str, Any] = {
        "name": area.name,
        "id": area.id,
        "floor": area.floor,
        "area": [*area.low, *area.high],
    }
    if area.walls:
        description["walls"] = _polylines(area.walls)
    files: dict[str, bytes] = {}
    if area.grid:
        image = area.image or _drawn(area.grid, stem)
        if {image.name, image.picture_name} & taken:  # of another map, from another folder
            image = _drawn(area.grid, _free_stem(f"map-{area.id}", ".yaml", taken))
        files = {image.name: image.description, image.picture_name: image.picture}
        description["image"] = image.name
    marks = _free_stem(stem, MARK_INFO, taken | set(files)) + MARK_INFO
    files[marks] = mark_info_of(area).SerializeToString(deterministic=True)
    description["mark_info"] = marks
    return description, files


def _free_stem(stem: str, suffix: str, taken: set[str]) -> str:
    """Return `stem`, lengthened if the file with this suffix would not be new."""
    while f"{stem}{suffix}" in taken:
        stem += "-"
    return stem


def _polylines(walls: tuple[Wall, ...]) -> list[list[float]]:
    """Return walls as polylines: x and y of each corner."""
    lines: list[list[float]] = []
    for wall in walls:
        if lines and lines[-1][-2:] == [wall.x1, wall.y1]:
            lines[-1] += [wall.x2, wall.y2]
        else:
            lines.append([wall.x1, wall.y1, wall.x2, wall.y2])
    return lines


@lru_cache(maxsize=32)
def _drawn(grid: Grid, stem: str) -> ImageFiles:
    """Return a grid as a map of map_server."""
    # numpy and Pillow load slowly, and only pictures need them.
    from woosh_robot_agent.simulator.world.picture import png

    picture = f"{stem}.png"
    description = {
        "image": picture,
        "mode": "trinary",
        "resolution": grid.resolution,
        "origin": [*grid.low, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    text = yaml.safe_dump(description, sort_keys=False, allow_unicode=True)
    return ImageFiles(f"{stem}.yaml", text.encode(), picture, png(grid.cells))
