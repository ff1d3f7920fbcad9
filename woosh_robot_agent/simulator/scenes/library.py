"""The scenes that a robot knows at startup: the shipped ones and those of the configuration.

The shipped scenes are in the folder `data/`. `wooshmap` is a hall with two partitions, three
pillars and a gate. `scenex` is the same hall furnished differently, with a second, empty floor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.geometry import Point, Pose
from woosh_robot_agent.simulator.world.maps import Map

MAX_SCENES = 20
"""Number of known scenes from which on new ones are refused."""

_SHIPPED = tuple(Path(__file__).parents[1] / "data" / name for name in ("wooshmap", "scenex"))
_START_CLEARANCE = 0.6
"""Minimum clearance of a start place that the scene does not define, in metres."""


def known_scenes(given: Iterable[Path] = ()) -> tuple[dict[str, Scene], Scene]:
    """Return the scenes that a robot knows, by name, and the one in which it starts.

    Args:
        given: Folders or files of further scenes, as for `load_scene`. They replace shipped ones of
            the same name. The robot starts in the first of them.

    Raises:
        DataFileError: A file cannot be used.
    """
    shipped, own = [_loaded(path) for path in _SHIPPED], [_loaded(path) for path in given]
    return {scene.name: scene for scene in shipped + own}, (own or shipped)[0]


def start(scene: Scene) -> tuple[Map, Pose]:
    """Return the map and the pose where a robot starts: any free place by default."""
    area = scene.map(scene.start_map) or scene.maps[0]
    return area, scene.start or Pose(*_free_place(area))


def _free_place(area: Map) -> Point:
    """Return the origin, a mark, or the place of a grid with the most room around it."""
    for point in ((0.0, 0.0), *(mark.pose.point for mark in area.marks.values())):
        if area.contains(*point) and area.clearance(*point) >= _START_CLEARANCE:
            return point
    return area.grid.roomiest() if area.grid else (0.0, 0.0)


def _loaded(path: Path) -> Scene:
    """Return a new scene. Its maps are shared, so that their planners are computed only once."""
    scene = _read_once(path) if path in _SHIPPED else load_scene(path)
    return dataclasses.replace(scene, maps=list(scene.maps), files={})


@lru_cache
def _read_once(path: Path) -> Scene:
    return load_scene(path)
