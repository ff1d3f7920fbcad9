"""The folder in which a scene is saved.

- `scene.yaml` lists what is there.
- `maps/NAME.yaml` and `maps/NAME.png` are the map NAME for nav2's map_server.
- `marks/NAME.yaml` has the marks of the map, for people to edit.
- `files/` has the scene's own files, as the robot sent them.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml
from google.protobuf.message import DecodeError

from woosh_robot_agent.map_image import MapError
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.map.mark_pb2 import MarkInfo
from woosh_robot_agent.simulator.yaml_fields import DataFileError, Node, parse
from woosh_robot_agent.tools.maps.errors import MapsError
from woosh_robot_agent.tools.maps.file_names import to_file_name
from woosh_robot_agent.tools.maps.marks_file import read_marks, write_marks
from woosh_robot_agent.tools.nav2_map import map_files

_INDEX = "scene.yaml"
"""File that lists what is in the folder."""
_MAPS, _MARKS, _FILES = "maps", "marks", "files"
"""Folders inside the folder."""
_FORMAT = 1
"""Version of the format of the folder."""
_MAX_ITEMS = 10_000
"""Maximum number of maps and of files of a scene."""
_MAX_INDEX = 1024 * 1024
"""Maximum size of the list, in bytes."""


@dataclass(frozen=True)
class SavedScene:
    """A scene in a folder.

    Attributes:
        name: Name of the scene.
        maps: Names of its maps.
        files: The scene's own files, by the robot's names for them. Edited marks are in them.
        loose_marks: YAML files of the marks that none of the scene's own files contains, by the
            name of the map.
    """

    name: str
    maps: list[str]
    files: dict[str, bytes]
    loose_marks: dict[str, Path]


def scene_path(folder: Path, scene: str) -> Path:
    """Return the folder of a scene inside another folder.

    Raises:
        MapsError: The name of the scene cannot be a file name.
    """
    return folder / to_file_name(scene)


def check_writable(target: Path, *, force: bool) -> None:
    """Check that a scene may be saved in a folder.

    Raises:
        MapsError: There is something that must not be overwritten.
    """
    if not os.path.lexists(target):
        return
    if not force:
        raise MapsError(
            f"{target} exists already: use --force to replace it, or --output for another folder"
        )
    if target.is_symlink() or not (target / _INDEX).is_file():
        raise MapsError(f"{target} is not a saved scene and is not replaced: move it first")


def write_scene(
    target: Path, data: SceneData, files: Mapping[str, bytes], *, force: bool
) -> list[str]:
    """Save a scene in a folder, all of it or nothing.

    Args:
        target: The folder, which is created.
        data: The maps with their pictures and marks.
        files: The scene's own files.
        force: Replace an older folder.

    Returns:
        Which maps are not there for map_server because the robot sent no usable picture, and why.

    Raises:
        MapsError: The scene cannot be saved.
    """
    contents: dict[str, bytes] = {}
    unusable: list[str] = []
    maps: list[dict[str, object]] = []
    for area in data.maps:
        stem = to_file_name(area.name)
        try:
            for name, content in map_files(area, stem).items():
                contents[f"{_MAPS}/{name}"] = content
        except MapError as error:  # the scene's own files may be worth saving all the same
            unusable.append(f"map {area.name} is not saved for map_server: {error}")
        contents[f"{_MARKS}/{stem}.yaml"] = write_marks(area.mark_info, area.name)
        maps.append({"name": area.name, "mark_file": _mark_file(area, files)})
    for name, content in files.items():
        contents[f"{_FILES}/{to_file_name(name)}"] = content
    index = {"format": _FORMAT, "scene": data.name, "maps": maps, "files": sorted(files)}
    contents[_INDEX] = yaml.safe_dump(index, sort_keys=False, allow_unicode=True).encode()
    try:
        _write_folder(target, contents, force=force)
    except OSError as error:
        raise MapsError(f"scene {data.name} cannot be saved: {error}") from None
    return unusable


def read_scene(folder: Path) -> SavedScene:
    """Read a saved scene.

    Raises:
        MapsError: The folder cannot be used.
    """
    index = folder / _INDEX
    if not index.exists():
        inside = _scenes_in(folder)
        if inside:
            raise MapsError(f"{folder} is not a saved scene: give a folder in it: {inside}")
    try:
        root = parse(str(index), _read(index), _MAX_INDEX)
        root.check_keys(("format", "scene", "maps", "files"))
        root.required("format").integer(_FORMAT, _FORMAT)
        scene = root.required("scene").text()
        nodes = root.required("files").items(_MAX_ITEMS)
        names = [node.text() for node in nodes]
        files = {name: _read(folder / _FILES / to_file_name(name)) for name in names}
        maps: list[str] = []
        loose_marks: dict[str, Path] = {}
        for node in root.required("maps").items(_MAX_ITEMS):
            name = node.check_keys(("name", "mark_file")).required("name").text()
            maps.append(name)
            path = folder / _MARKS / f"{to_file_name(name)}.yaml"
            mark_file = node.get("mark_file")
            if mark_file:
                _update_marks(files, mark_file, path)
            else:
                loose_marks[name] = path
    except DataFileError as error:
        raise MapsError(str(error)) from None
    return SavedScene(scene, maps, files, loose_marks)


def _scenes_in(folder: Path) -> str:
    """Return the folders of the saved scenes in a folder, as a text for people."""
    return ", ".join(str(index.parent) for index in sorted(folder.glob(f"*/{_INDEX}")))


def edited_marks(path: Path, old: MarkInfo) -> MarkInfo:
    """Return the marks in a YAML file; `old` itself if they are the same.

    Raises:
        MapsError: The file cannot be used.
    """
    return read_marks(str(path), _read(path), old)


def _update_marks(files: dict[str, bytes], mark_file: Node, path: Path) -> None:
    """Put the marks in a YAML file into the scene's own file for them."""
    name = mark_file.choice(files)
    try:
        old = MarkInfo.FromString(files[name])
    except DecodeError as error:
        raise mark_file.error(f"{name} has no marks: {error}: download the scene again") from None
    new = edited_marks(path, old)
    if new is not old:
        files[name] = new.SerializeToString()


def _mark_file(area: SceneData.Map, files: Mapping[str, bytes]) -> str | None:
    """Return which of a scene's own files contains the marks of a map; None if it is not clear.

    The names of these files differ between robots, so the content decides.
    """
    if not area.mark_info.ByteSize():
        return None
    found = [name for name, content in files.items() if _contains(content, area.mark_info)]
    if len(found) > 1:
        found = [name for name in found if name.startswith((f"{area.name}.", f"{area.name}/"))]
    return found[0] if len(found) == 1 else None


def _contains(content: bytes, info: MarkInfo) -> bool:
    try:
        return bool(MarkInfo.FromString(content) == info)
    except DecodeError:
        return False


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise MapsError(f"{path} cannot be read: {error.strerror or error}") from None


def _write_folder(target: Path, contents: Mapping[str, bytes], *, force: bool) -> None:
    """Write a folder under another name, then rename it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=".maps-", dir=target.parent))
    try:
        new, old = work / "new", work / "old"
        for name, content in contents.items():
            path = new / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        check_writable(target, force=force)
        if target.exists():
            target.rename(old)
        try:
            new.rename(target)
        except OSError:
            if old.exists():
                old.rename(target)
            raise
    finally:
        shutil.rmtree(work, ignore_errors=True)
