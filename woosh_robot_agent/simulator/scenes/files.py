"""Find and read scenes: a robot's folder, a folder with `scene.yaml`, or nav2's maps.

The shipped scenes are in the folder `data/`. `wooshmap` is a hall with two partitions, three
pillars and a gate. `scenex` is the same hall furnished differently, with a second, empty floor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.simulator.scenes.robot_files import FileReader, map_names, read_robot_scene
from woosh_robot_agent.simulator.scenes.scene import SCENE_INDEX, Scene
from woosh_robot_agent.simulator.scenes.scene_yaml import SCENE_FILE, read_maps, read_scene_yaml
from woosh_robot_agent.simulator.world.geometry import Point, Pose
from woosh_robot_agent.simulator.world.maps import Map

_ADDED_FOLDERS = ("nav2", "marks")
"""Folders that `maps download` adds to those of the robot, unless a map has this name."""

_MAX_FILE_BYTES = 64 * 1024 * 1024
"""Maximum size of a file, in bytes."""


def load_scene(path: Path) -> Scene:
    """Read a scene from a folder, or from a YAML file: `scene.yaml`, or a map of map_server."""
    try:
        if (path / SCENE_INDEX).is_file():
            return read_robot_scene(path.resolve().name, read_robot_folder(path))
        if path.is_dir():
            folder, name = path, path.resolve().name
            names = [file.name for file in path.iterdir()]
        else:
            path.stat()  # raises an error if there is no such file
            folder, names = path.parent, [path.name]
            name = path.resolve().parent.name if path.name == SCENE_FILE else path.stem
    except OSError as error:
        raise DataFileError(f"{path}: {error.strerror}") from error
    scene = read_handwritten_scene(name, names, lambda each: _read_file(folder / each))
    if scene is None:
        raise DataFileError(
            f"{path}: not a scene: give a folder with {SCENE_INDEX} or {SCENE_FILE}, or a YAML "
            "file of nav2's map_server or a folder with one"
        )
    return scene


def read_robot_folder(folder: Path) -> dict[str, bytes]:
    """Return the files in a robot's folder of a scene, by path as the robot names them.

    Hidden entries of the folder, and the folders that `maps download` adds, are left out.
    """
    maps = map_names(_read_file(folder / SCENE_INDEX))
    files: dict[str, bytes] = {}
    try:
        found = [each for each in sorted(folder.rglob("*")) if each.is_file()]
    except OSError as error:
        raise DataFileError(f"{folder}: {error.strerror}") from error
    for file in found:
        name = file.relative_to(folder)
        added = name.parts[0] in _ADDED_FOLDERS and name.parts[0] not in maps
        if not added and not name.parts[0].startswith("."):
            # `maps download` percent-encodes names that would not be valid paths.
            files[unquote(name.as_posix())] = _read_file(file)
    return files


def read_handwritten_scene(name: str, names: Collection[str], read: FileReader) -> Scene | None:
    """Read a `scene.yaml`, or maps of map_server; return None if there are neither.

    Args:
        name: name of the scene, unless `scene.yaml` has one.
        names: names of the files.
        read: reads one of the files.
    """
    if SCENE_FILE in names:
        return read_scene_yaml(name, read)
    maps = read_maps(names, read)
    return Scene(name, maps) if maps else None


def _read_file(file: Path) -> bytes:
    """Return the content of a file; raise DataFileError if it is unreadable or too large."""
    try:
        if file.stat().st_size > _MAX_FILE_BYTES:
            raise DataFileError(f"{file}: the file has more than {_MAX_FILE_BYTES} bytes")
        return file.read_bytes()
    except OSError as error:
        raise DataFileError(f"{file}: {error.strerror or error}") from error


MAX_SCENES = 20
"""Maximum number of known scenes; further scenes are refused."""

_SHIPPED = tuple(Path(__file__).parents[1] / "data" / name for name in ("wooshmap", "scenex"))
_START_CLEARANCE = 0.6
"""Minimum clearance of a start place that the scene does not define, in metres."""


def known_scenes(given: Iterable[Path] = ()) -> tuple[dict[str, Scene], Scene]:
    """Return the scenes that a robot knows, by name, and the one in which it starts.

    Args:
        given: folders or YAML files of further scenes. They replace shipped scenes of the same
            name. The robot starts in the first of these scenes, if there are any.
    """
    shipped = [_load(path) for path in _SHIPPED]
    own: dict[str, Scene] = {}
    for path in given:
        scene = _load(path)
        if scene.name in own:
            raise DataFileError(f"{path}: another scene is called {scene.name}, too; rename one")
        own[scene.name] = scene
    first = next(iter(own.values()), shipped[0])
    return {scene.name: scene for scene in shipped} | own, first


def start_place(scene: Scene) -> tuple[Map, Pose]:
    """Return the map and the pose at which a robot starts: by default any free place."""
    area = scene.map(scene.start_map) or scene.maps[0]
    return area, scene.start or Pose(*_free_place(area))


def _free_place(area: Map) -> Point:
    """Return the origin or a mark if there is room, or else the roomiest place of a grid.

    Without a grid, return the origin.
    """
    for point in ((0.0, 0.0), *(mark.pose.point for mark in area.marks.values())):
        if area.contains(*point) and area.clearance(*point) >= _START_CLEARANCE:
            return point
    return area.grid.roomiest() if area.grid else (0.0, 0.0)


_load_shipped = lru_cache(load_scene)


def _load(path: Path) -> Scene:
    """Return a scene that a robot can change without effect on the scenes of other robots.

    All robots share the shipped maps, so that the planner of each map is computed only once.
    """
    try:
        scene = _load_shipped(path) if path in _SHIPPED else load_scene(path)
    except DataFileError as error:  # its text may lack the folder: "scene.yaml: ..."
        text = str(error)
        raise DataFileError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    return dataclasses.replace(scene, maps=list(scene.maps), files=dict(scene.files))
