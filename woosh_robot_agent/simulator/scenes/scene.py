"""A scene: the maps of a site with their marks, and the tasks that are defined there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import PurePosixPath

import yaml

from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import ImageFiles, Map, Mark, MarkKind
from woosh_robot_agent.simulator.yaml_fields import parse


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
    description = {**parse(image.name, image.description).value, "image": picture_name}
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
