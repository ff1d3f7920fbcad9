"""The scenes that a simulated chassis knows at its start: the shipped ones, and those it is given.

`wooshmap` is a hall with two partitions, three pillars and a gate; `scenex` is the same hall
furnished differently, with a second, empty floor. See `data/`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.simulator.world.geometry import Point, Pose
from woosh_robot_agent.simulator.world.maps import Map, Scene

_SHIPPED = tuple(Path(__file__).parents[1] / "data" / name for name in ("wooshmap", "scenex"))
#: m of free floor around a place where a robot starts without being told to.
_START_ROOM_M = 0.6


def known_scenes(given: Iterable[Path] = ()) -> tuple[dict[str, Scene], Scene]:
    """The scenes that a chassis knows, by name, and the one in which it starts.

    Args:
        given: Folders or files of further scenes, as for `load_scene`. They replace shipped ones of
            the same name. The chassis starts in the first.

    Raises:
        SceneError: A file cannot be used.
    """
    shipped, own = [_loaded(path) for path in _SHIPPED], [_loaded(path) for path in given]
    return {scene.name: scene for scene in shipped + own}, (own or shipped)[0]


def start(scene: Scene) -> tuple[Map, Pose]:
    """The map and the pose where a robot starts, if the scene says nothing some free place."""
    area = scene.map(scene.start_map) or scene.maps[0]
    return area, scene.start or Pose(*_free_place(area))


def _free_place(area: Map) -> Point:
    """The origin, a mark or, on a grid, the place with the most room."""
    for point in ((0.0, 0.0), *(mark.pose.point for mark in area.marks.values())):
        if area.contains(*point) and area.clearance(*point) >= _START_ROOM_M:
            return point
    return area.grid.roomiest() if area.grid else (0.0, 0.0)


def _loaded(path: Path) -> Scene:
    """A scene of one's own, whose maps are shared: planners and distance fields stay with them."""
    scene = _read_once(path) if path in _SHIPPED else load_scene(path)
    return dataclasses.replace(scene, maps=list(scene.maps), files={})


@lru_cache
def _read_once(path: Path) -> Scene:
    return load_scene(path)
