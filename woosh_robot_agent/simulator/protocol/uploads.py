"""Files of a scene that a client uploads with SwitchMap.

They are kept in memory, never on disk. If all files of a scene together describe a scene or maps in
a format of `scenes.files`, the scene is replaced. Other files are only kept. An invalid upload
changes nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePosixPath, PureWindowsPath

from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.files import SCENE_FILE, read_scene
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.yaml_fields import DataFileError

_MAX_FILES = 100
"""Maximum number of files of a scene."""

_MAX_BYTES = 32 * 1024 * 1024
"""Maximum size of all files of a scene together, in bytes."""

_MAX_NAME = 255
"""Maximum length of a file name."""


def updated_scene(name: str, before: Scene | None, files: dict[str, bytes]) -> Scene | None:
    """Return a scene after an upload, with the version of each map increased.

    Args:
        name: Name of the scene.
        before: The scene before the upload, None if it is new.
        files: All files of the scene, as from `merge_files`.

    Returns:
        The scene, or None if the scene is new and no file describes it.

    Raises:
        RefusedError: A file is invalid.
    """
    try:
        scene = read_scene(name, files, _reader(files))
    except DataFileError as error:
        raise RefusedError(refusals.SCENE_INVALID, scene=name, error=error) from error
    if before is None:
        return scene and dataclasses.replace(scene, files=files)
    newer = [dataclasses.replace(each, version=each.version + 1) for each in before.maps]
    if scene is None:
        return dataclasses.replace(before, maps=newer, files=files)
    if SCENE_FILE not in files:
        return dataclasses.replace(before, maps=_merged(newer, scene.maps), files=files)
    versions = {each.name: each.version for each in newer}
    maps = [
        dataclasses.replace(each, version=max(each.version, versions.get(each.name, 1)))
        for each in scene.maps
    ]
    return dataclasses.replace(scene, maps=maps, files=files)


def first_map(scene: Scene, upload: Iterable[common_pb2.FileData]) -> str:
    """Return the name of the first uploaded map of map_server, empty if there is none."""
    stems = {PurePosixPath(file.name).stem for file in upload}
    if SCENE_FILE in scene.files:
        return ""
    return next((each.name for each in scene.maps if each.grid and each.name in stems), "")


def merge_files(
    before: Mapping[str, bytes], upload: Iterable[common_pb2.FileData]
) -> dict[str, bytes]:
    """Return the files of a scene with those of an upload.

    Raises:
        RefusedError: A file name is invalid, or the files are too many or too large.
    """
    new: dict[str, bytes] = {}
    for file in upload:
        name = file.name
        # Nothing is written to disk, but a name must not be a path on any system.
        plain = PurePosixPath(name).name == PureWindowsPath(name).name == name
        if not plain or name in ("", "..") or not name.isprintable() or len(name) > _MAX_NAME:
            raise RefusedError(refusals.FILE_NAME_INVALID, file=name[:_MAX_NAME], limit=_MAX_NAME)
        if name in new:
            raise RefusedError(refusals.FILE_TWICE, file=name)
        new[name] = file.data
    files = {**before, **new}
    size = sum(map(len, files.values()))
    if len(files) > _MAX_FILES or size > _MAX_BYTES:
        raise RefusedError(
            refusals.SCENE_TOO_LARGE,
            count=len(files),
            size=size,
            max_count=_MAX_FILES,
            max_size=_MAX_BYTES,
        )
    return files


def _reader(files: Mapping[str, bytes]) -> Callable[[str], bytes]:
    def read(name: str) -> bytes:
        try:
            return files[name]
        except KeyError:
            raise DataFileError(f"{name}: the file is missing: upload it too") from None

    return read


def _merged(before: list[Map], pictures: list[Map]) -> list[Map]:
    """Return the maps of a scene with those of an upload. A replaced map keeps its marks."""
    maps = {each.name: each for each in before}
    free_id = max(each.id for each in before) + 1
    for each in pictures:
        old = maps.get(each.name)
        if old:
            maps[each.name] = dataclasses.replace(
                each, id=old.id, floor=old.floor, version=old.version, marks=old.marks
            )
        else:
            maps[each.name] = dataclasses.replace(each, id=free_id)
            free_id += 1
    return list(maps.values())
