"""The files of a scene, as `scenes.files` reads them.

Each map NAME has `NAME.mark_info.data`, and a map of map_server if it has a grid: a YAML file and a
picture. The scene has `scene.yaml`, `task_info.data`, and the files that clients uploaded and that
describe nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import yaml

from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.simulator.scenes.files import MARK_INFO, SCENE_FILE, TASK_INFO, is_plain
from woosh_robot_agent.simulator.scenes.scene import Scene, mark_info_of
from woosh_robot_agent.simulator.world.geometry import Wall
from woosh_robot_agent.simulator.world.maps import ImageFiles, Map

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.world.grid import Grid


@dataclass(frozen=True)
class SceneFiles:
    """The files of a scene, by name. All names are plain file names.

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
        description, files = _map(area, taken)
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


def _map(area: Map, taken: set[str]) -> tuple[dict[str, Any], dict[str, bytes]]:
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
            image = _drawn(area.grid, _free(f"map-{area.id}", ".yaml", taken))
        files = {image.name: image.description, image.picture_name: image.picture}
        description["image"] = image.name
    marks = _free(stem, MARK_INFO, taken | set(files)) + MARK_INFO
    files[marks] = mark_info_of(area).SerializeToString(deterministic=True)
    description["mark_info"] = marks
    return description, files


def _free(stem: str, suffix: str, taken: set[str]) -> str:
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
