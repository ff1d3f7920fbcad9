"""Changes of scenes. Each returns a new scene, whose changed maps have the next version."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import count
from pathlib import PurePosixPath

import yaml

from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.maps import ImageFiles, Map, Mark
from woosh_robot_agent.simulator.yaml_fields import parse

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
