"""The files of a scene that a client uploads.

The files are kept in memory, never on disk. Files that describe the scene, its maps, marks or tasks
take effect; others are only kept. An invalid upload changes nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePosixPath

from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.action_groups import ACTION_GROUPS, read_action_groups
from woosh_robot_agent.simulator.scenes.files import read_handwritten_scene
from woosh_robot_agent.simulator.scenes.robot_files import (
    MAX_MAPS,
    check_unused_files,
    read_mark_info,
    read_robot_scene,
)
from woosh_robot_agent.simulator.scenes.scene import (
    MAX_NAME,
    SCENE_INDEX,
    Scene,
    files_of,
    is_plain,
    mark_info_of,
    with_map,
    with_map_changed,
)
from woosh_robot_agent.simulator.scenes.scene_yaml import SCENE_FILE, read_maps
from woosh_robot_agent.simulator.world.maps import Map

_MAX_FILES = 1000
"""Maximum number of files of a scene."""

_MAX_SCENE = 32 * 1024 * 1024
"""Maximum size of all files of a scene together, in bytes."""

_MAX_FOLDERS = 4
"""Maximum number of folders in the path of a file."""

_PICTURES = (".png", ".pgm")
"""Suffixes of the file names of pictures."""


def updated_scene(
    name: str,
    old: Scene | None,
    upload: Iterable[common_pb2.FileData],
    *,
    replace: bool = False,
) -> Scene:
    """Return a scene after an upload. Each map that has changed gets a higher version.

    If all files of a robot's folder are uploaded, each map keeps the version in these files, unless
    that is the version of the old map.

    Args:
        old: the scene before the upload, None if it is new.
        upload: the uploaded files: files of a robot's folder, a `scene.yaml`, or maps of
            map_server.
        replace: True to drop the old files of the scene.

    Raises:
        RefusedError: a file is invalid, or no file describes the scene.
    """
    new = merge_files({}, upload)
    _check_pictures(new)
    files = merge_files(files_of(old).all if old and not replace else {}, upload)
    try:
        scene = _read_upload(name, old, new, files)
    except DataFileError as error:
        raise RefusedError(f"scene {name} is not changed: {error}") from error
    if scene is None:
        raise RefusedError(
            f"no file describes a map of scene {name}: add {SCENE_INDEX} with the folders of its "
            "maps, or the YAML file and the picture of a map of map_server"
        )
    _check_map_files(scene)
    if len(scene.maps) > MAX_MAPS:
        raise RefusedError(refusals.TOO_MANY_MAPS, scene=name, limit=MAX_MAPS)
    whole = replace and SCENE_INDEX in new  # all files of a robot's folder
    for area in scene.maps:
        before = old.map(area.name) if old else None
        if before:
            scene = with_map_changed(scene, area, _successor(area, before, whole=whole))
    return scene


def _read_upload(
    name: str, old: Scene | None, new: Mapping[str, bytes], files: Mapping[str, bytes]
) -> Scene | None:
    """Return the scene that an upload describes, None if it describes no scene.

    Args:
        old: the scene before the upload, None if it is new.
        new: the uploaded files.
        files: all files of the scene after the upload.

    Raises:
        DataFileError: a file is invalid.
    """
    used: set[str] = set()  # files whose content is in the maps, so that they are not kept
    read = _reader(new, used)
    is_robot_folder = SCENE_INDEX in files and SCENE_FILE not in new
    if is_robot_folder:
        # such a folder has its files in the folders of maps; maps of map_server lie beside these
        maps = read_maps([each for each in new if "/" not in each], read)
        kept = {each: data for each, data in files.items() if each not in used}
        scene = read_robot_scene(name, kept, old)
        for area in maps:
            scene = with_map(scene, area)
        return scene
    handwritten = read_handwritten_scene(name, new, read)
    if handwritten:
        handwritten.name = name  # `scene.yaml` may have another one
        handwritten.files = {each: data for each, data in new.items() if each not in used}
        groups = handwritten.files.pop(ACTION_GROUPS, b"")
        handwritten.action_groups = read_action_groups(groups)
    return handwritten


def _successor(area: Map, before: Map, *, whole: bool) -> Map:
    """Return an uploaded map with its new version, and with what is known from the old map.

    That is the real walls of a map that the robot has made (`ground_truth`), and its last pose
    there (`end`), unless the upload has one, or is a whole folder.

    Args:
        area: the map as its files describe it.
        before: the old map, which it replaces.
        whole: True if all files of a robot's folder are uploaded.
    """
    if not whole:
        area = dataclasses.replace(area, end=area.end or before.end)
    changed = mark_info_of(area) != mark_info_of(before)
    if not area.same_ground(before):
        changed = True
        # The files show only what the robot has seen: the walls stay where they are.
        area = dataclasses.replace(area, ground_truth=before.ground_truth)
    if not changed or (whole and area.version != before.version):
        return area
    return dataclasses.replace(area, version=max(area.version, before.version + 1))


def first_map(scene: Scene, upload: Iterable[common_pb2.FileData]) -> str:
    """Return the name of the scene's first map that an uploaded file of map_server describes.

    It is empty if there is none, or if `scene.yaml` lists the maps.
    """
    names = {file.name for file in upload}
    if SCENE_FILE in names:
        return ""
    stems = {PurePosixPath(name).stem for name in names if "/" not in name}
    return next((each.name for each in scene.maps if each.grid and each.name in stems), "")


def _check_map_files(scene: Scene) -> None:
    """Check the files that a scene keeps for its maps, even if `scene.yaml` describes the maps."""
    try:
        for area in scene.maps:
            read_mark_info(area.name, scene.files)
            check_unused_files(area.name, scene.files)
    except DataFileError as error:
        raise RefusedError(f"scene {scene.name} is not changed: {error}") from error


def _check_pictures(upload: Mapping[str, bytes]) -> None:
    """Raise RefusedError if a picture of an upload cannot be read, even if no map uses it."""
    for name, data in upload.items():
        if PurePosixPath(name).suffix.lower() in _PICTURES:
            # numpy and Pillow load slowly, and only pictures need them.
            from woosh_robot_agent.simulator.scenes.map_server import read_pixels

            try:
                read_pixels(name, data)
            except DataFileError as error:
                raise RefusedError(f"{error}") from error


def merge_files(
    old: Mapping[str, bytes], upload: Iterable[common_pb2.FileData]
) -> dict[str, bytes]:
    """Return the files of a scene after an upload, which adds files and replaces files."""
    new: dict[str, bytes] = {}
    for file in upload:
        # A client that downloads the files writes them to a folder: no name may lead out of it.
        parts = file.name.split("/")
        if len(parts) > _MAX_FOLDERS + 1 or not all(map(is_plain, parts)):
            name = file.name[:MAX_NAME]
            raise RefusedError(
                f"file {name!r}: the name must be a plain file name of at most {MAX_NAME} "
                "characters, or such names with slashes between them"
            )
        if file.name in new:
            raise RefusedError(f"file {file.name} is uploaded twice")
        new[file.name] = file.data
    files = {**old, **new}
    size = sum(map(len, files.values()))
    if len(files) > _MAX_FILES or size > _MAX_SCENE:
        raise RefusedError(
            f"{len(files)} files of {size} bytes are more than the limit of a scene: "
            f"{_MAX_FILES} files, {_MAX_SCENE} bytes"
        )
    return files


def _reader(files: Mapping[str, bytes], used: set[str]) -> Callable[[str], bytes]:
    """Return a function that returns one of `files`, and adds its name to `used`."""

    def read(name: str) -> bytes:
        try:
            data = files[name]
        except KeyError:
            raise DataFileError(f"{name}: the file is missing: upload it too") from None
        used.add(name)
        return data

    return read
