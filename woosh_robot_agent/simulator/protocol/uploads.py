"""Files of a scene that a client uploads with Upload or SwitchMap.

They are kept in memory, never on disk. If they describe a scene, maps or marks in a format of
`scenes.files`, these are replaced. Other files are only kept. An invalid upload changes nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePosixPath

from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.protocol.handlers import require_inside
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.editing import with_map
from woosh_robot_agent.simulator.scenes.file_names import MAX_NAME, is_plain
from woosh_robot_agent.simulator.scenes.files import MAX_MAPS, SCENE_FILE, read_maps, read_scene
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.scenes.writing import files_of
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.yaml_fields import DataFileError

_MAX_FILES = 100
"""Maximum number of files of a scene."""

_MAX_BYTES = 32 * 1024 * 1024
"""Maximum size of all files of a scene together, in bytes."""

_SAME_PLACE = 0.001
"""Distance up to which a mark of an upload is where it was, in metres. Files round positions."""

_PICTURES = (".png", ".pgm")
"""Ends of the names of pictures."""


def updated_scene(
    name: str,
    old: Scene | None,
    upload: Iterable[common_pb2.FileData],
    *,
    replace: bool = False,
) -> Scene | None:
    """Return a scene after an upload, with the version of each map increased.

    Args:
        name: Name of the scene.
        old: The scene before the upload, None if it is new.
        upload: The uploaded files.
        replace: The uploaded files are the only ones of the scene.

    Returns:
        The scene, or None if no file describes it.

    Raises:
        RefusedError: A file is invalid.
    """
    kept = old if not replace else None
    new = merge_files({}, upload)
    files = merge_files(files_of(kept).all if kept else {}, upload)
    used: set[str] = set()
    read = _reader(files, used)
    try:
        scene = read_scene(name, files, read)
        if scene and SCENE_FILE in files and SCENE_FILE not in new:
            for area in read_maps(new.keys() - used, read):
                scene = with_map(scene, area)
    except DataFileError as error:
        raise RefusedError(refusals.SCENE_INVALID, scene=name, error=error) from error
    if scene is None:
        return None
    if len(scene.maps) > MAX_MAPS:
        raise RefusedError(refusals.TOO_MANY_MAPS, scene=name, limit=MAX_MAPS)
    others = {**(kept.files if kept else {}), **new}
    scene.files.update((file, data) for file, data in others.items() if file not in used)
    before = {each.name: each for each in old.maps} if old else {}
    for area in scene.maps:
        kept_marks = before[area.name].marks if area.name in before else {}
        for number, mark in area.marks.items():
            former = kept_marks.get(number)
            # A new picture may leave out marks that the map keeps.
            if former is None or former.pose.distance(mark.pose.point) > _SAME_PLACE:
                require_inside(mark, area)
    scene.maps = [_continued(each, before.get(each.name)) for each in scene.maps]
    return scene


def _continued(area: Map, old: Map | None) -> Map:
    """Return a map with what it keeps of the one of its name before."""
    if old is None:
        return area
    return dataclasses.replace(
        area,
        version=max(area.version, old.version + 1),
        end=old.end,
        # The files show only what the robot has seen: the walls stay where they are.
        ground_truth=old.ground_truth,
    )


def first_map(scene: Scene, upload: Iterable[common_pb2.FileData]) -> str:
    """Return the name of the first uploaded map of map_server, empty if there is none."""
    names = {file.name for file in upload}
    if SCENE_FILE in names:
        return ""
    stems = {PurePosixPath(name).stem for name in names}
    return next((each.name for each in scene.maps if each.grid and each.name in stems), "")


def check_pictures(upload: Iterable[common_pb2.FileData]) -> None:
    """Check that each picture of an upload can be read, also those that no map uses.

    Raises:
        RefusedError: A picture cannot be read.
    """
    for file in upload:
        if PurePosixPath(file.name).suffix.lower() in _PICTURES:
            # numpy and Pillow load slowly, and only pictures need them.
            from woosh_robot_agent.simulator.scenes.map_server import check_picture

            try:
                check_picture(file.name, file.data)
            except DataFileError as error:
                raise RefusedError(refusals.FILE_INVALID, error=error) from error


def merge_files(
    old: Mapping[str, bytes], upload: Iterable[common_pb2.FileData]
) -> dict[str, bytes]:
    """Return the files of a scene with those of an upload.

    Raises:
        RefusedError: A file name is invalid, or the files are too many or too large.
    """
    new: dict[str, bytes] = {}
    for file in upload:
        # Nothing is written to disk, but a name must not be a path on any system.
        if not is_plain(file.name):
            name = file.name[:MAX_NAME]
            raise RefusedError(refusals.FILE_NAME_INVALID, file=name, limit=MAX_NAME)
        if file.name in new:
            raise RefusedError(refusals.FILE_TWICE, file=file.name)
        new[file.name] = file.data
    files = {**old, **new}
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


def _reader(files: Mapping[str, bytes], used: set[str]) -> Callable[[str], bytes]:
    """Return a function that reads one of `files`, and adds its name to `used`."""

    def read(name: str) -> bytes:
        try:
            data = files[name]
        except KeyError:
            raise DataFileError(f"{name}: the file is missing: upload it too") from None
        used.add(name)
        return data

    return read
