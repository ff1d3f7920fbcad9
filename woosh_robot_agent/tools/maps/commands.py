"""The commands of `maps`, with a progress bar if stderr is a terminal.

Everything here raises `ToolError` if the robot refuses a request, does not answer it, or does not
have what is named.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeVar

from google.protobuf.message import Message
from rich.markup import escape
from rich.progress import DownloadColumn, TimeElapsedColumn

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.link import Answer, ChassisClient, LinkError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import printable
from woosh_robot_agent.pb.map import map_pack_pb2 as pack
from woosh_robot_agent.pb.map.mark_pb2 import Storages
from woosh_robot_agent.pb.robot.robot_pb2 import Scene
from woosh_robot_agent.pb.util.common_pb2 import FileData
from woosh_robot_agent.tools.maps.scene_folder import (
    SavedScene,
    check_writable,
    read_scene,
    to_file_name,
    write_scene,
)
from woosh_robot_agent.tools.options import ToolError
from woosh_robot_agent.tools.progress import progress_bar

SLOW_ANSWERS = {
    "woosh.map.Download": 300.0,
    "woosh.map.Upload": 300.0,
    "woosh.map.SceneData": 300.0,
    "woosh.map.SceneDataEasy": 60.0,
    "woosh.map.SceneList": 60.0,
    "woosh.map.Rename": 60.0,
    "woosh.map.Delete": 60.0,
}
"""Minimum timeouts of requests, in seconds. Robots have taken minutes to save a map."""

_M = TypeVar("_M", bound=Message)
"""Class of the message in an answer."""


class MapLibrary:
    """The scenes and maps that one robot has stored; the link `chassis` must be ready."""

    def __init__(self, chassis: ChassisClient) -> None:
        self.chassis = chassis

    async def scenes(self) -> dict[str, list[str]]:
        """Return the names of all scenes, each with the names of its maps."""
        answer = await self.query(pack.SceneList(), pack.SceneList)
        return {scene.name: list(scene.maps) for scene in answer.scenes}

    async def current(self) -> Scene:
        """Return the current scene and map."""
        return await self.query(Scene(), Scene)

    async def download(self, scene: str) -> dict[str, bytes]:
        """Return the contents of a scene's files, by the robot's names for them.

        Raises:
            ToolError: the robot refused, did not answer, or sent no files or two of one name.
        """
        answer = await self.query(pack.Download(scene_name=scene), pack.DownloadResponse)
        files = {file.name: file.data for file in answer.file_datas}
        if len(files) < len(answer.file_datas):
            raise ToolError(f"the robot sent two files of the same name for scene {scene}")
        if not files:
            raise ToolError(f"the robot sent no files for scene {scene}")
        return files

    async def query(self, request: Message, cls: type[_M]) -> _M:
        """Send a request; return the body of the answer, which must be of class `cls`."""
        answer = await self.request(request)
        if not isinstance(answer.body, cls):
            raise ToolError(
                f"the robot answered {full_name(request)} with {answer.defect or answer.type}, "
                f"not with {full_name(cls)}: its firmware may not have this request"
            )
        return answer.body

    async def request(self, request: Message) -> Answer:
        """Send a request; return the answer."""
        make = RequestMaker(self.chassis.config.robot_id)
        try:
            answer = await self.chassis.request(make.address(request))
        except LinkError as error:
            raise ToolError(f"{full_name(request)}: {error}") from None
        if not answer.ok:
            raise ToolError(f"the robot refused {full_name(request)}: {answer.reason}")
        return answer


def _progress(
    chassis: ChassisClient, text: str, size: int | None = None
) -> AbstractContextManager[None]:
    """Show a text and a progress bar while the block runs.

    `size` is that of the files to upload, in bytes; None for a download, whose size is not known.
    """
    received_before, _ = chassis.traffic()
    # The frame of an upload is larger than the files in it, so the bar shows the sent share of the
    # frame, scaled to `size`. The size of the frame is the most bytes that have waited to be sent.
    frame_size = 0

    def update() -> dict[str, float]:
        nonlocal frame_size
        received, unsent = chassis.traffic()
        frame_size = max(frame_size, unsent)
        if size is None:
            return {"completed": max(0, received - received_before)}
        return {"completed": size * (1 - unsent / frame_size)} if frame_size else {}

    return progress_bar(escape(text), size, update, DownloadColumn(), TimeElapsedColumn())


async def list_maps(library: MapLibrary, *, as_json: bool) -> None:
    """Print the maps of all scenes, as a table or as JSON. A scene without maps is left out."""
    current = await library.current()
    rows: list[dict[str, object]] = []
    for scene in await library.scenes():
        overview = await library.query(pack.SceneDataEasy(name=scene), pack.SceneDataEasy)
        for area in overview.maps:
            is_current = (scene, area.name) == (current.scene_name, current.map_name)
            rows.append(
                {
                    "scene": scene,
                    "map": area.name,
                    "id": area.id,
                    "floor": area.floor,
                    "version": area.version,
                    "marks": _count(area.storages),
                    "current": is_current,
                }
            )
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    columns = ("scene", "map", "id", "floor", "version", "marks")
    table = [
        [name.upper() for name in columns],
        *([printable(str(row[name])) for name in columns] for row in rows),
    ]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for index, cells in enumerate(table):
        line = "  ".join(f"{cell:<{width}}" for cell, width in zip(cells, widths, strict=True))
        suffix = "  (current)" if index and rows[index - 1]["current"] else ""
        print(f"{line.rstrip()}{suffix}")


async def download(library: MapLibrary, names: Sequence[str], output: Path, *, force: bool) -> None:
    """Save scenes in folders.

    Args:
        names: names of scenes, or of maps whose scenes are saved; empty for all scenes.
        output: folder in which a folder is created for each scene.
        force: True to replace scenes that were saved there before.
    """
    known = await library.scenes()
    scenes = list(dict.fromkeys(_scene_of(name, known) for name in names)) if names else list(known)
    if not scenes:
        raise ToolError("the robot has no scenes")
    targets = {scene: output / to_file_name(scene) for scene in scenes}
    for target in targets.values():
        check_writable(target, force=force)
    for scene, target in targets.items():
        with _progress(library.chassis, f"downloading {printable(scene)}"):
            data = await library.query(pack.SceneData(name=scene), pack.SceneData)
            files = await library.download(scene)
        data.name = scene
        warnings = write_scene(target, data, files, force=force)
        marks = sum(len(area.mark_info.storages) for area in data.maps)
        counts = f"maps {len(data.maps)}, marks {marks}, files {len(files)}"
        print(printable(f"downloaded scene {scene} to {target}: {counts}"), flush=True)
        for text in warnings:
            print(f"warning: {printable(text)}", file=sys.stderr)


async def upload(
    library: MapLibrary, folders: Sequence[Path], new_name: str, *, force: bool
) -> None:
    """Upload saved scenes to the robot.

    Args:
        new_name: name of the scene on the robot; empty for its saved name.
        force: True to replace scenes on the robot.
    """
    saved = [read_scene(folder) for folder in folders]
    names = [new_name or each.name for each in saved]
    if len(set(names)) < len(names):
        raise ToolError(f"two folders have the same scene: {', '.join(names)}")
    known = await library.scenes()
    for name in names:
        if name in known and not force:
            raise ToolError(
                f"the robot has a scene {name} already: use --force to replace it, or --scene for "
                "another name"
            )
    for name, scene in zip(names, saved, strict=True):
        await _upload(library, name, scene)


async def rename(library: MapLibrary, scene: str, map_name: str, new_name: str) -> None:
    """Rename a scene, or one of its maps if `map_name` is not empty."""
    known = await library.scenes()
    what = _check_exists(known, scene, map_name)
    if new_name in (known[scene] if map_name else known):
        raise ToolError(f"{what} cannot be renamed: {new_name} exists already; choose another name")
    request = pack.Rename(old_scene_name=scene, new_scene_name=scene if map_name else new_name)
    if map_name:
        request.old_map_name, request.new_map_name = map_name, new_name
    await library.request(request)
    print(printable(f"renamed {what} to {new_name}"))


async def delete(library: MapLibrary, scene: str, map_name: str) -> None:
    """Delete a scene, or one of its maps if `map_name` is not empty."""
    what = _check_exists(await library.scenes(), scene, map_name)
    current = await library.current()
    if scene == current.scene_name and map_name in ("", current.map_name):
        raise ToolError(
            f"{what} cannot be deleted: the robot is using it; switch to another one first"
        )
    await library.request(pack.Delete(scene_name=scene, map_name=map_name))
    print(printable(f"deleted {what}"))


async def _upload(library: MapLibrary, name: str, scene: SavedScene) -> None:
    """Upload the files of a scene."""
    size = sum(map(len, scene.files.values()))
    datas = [FileData(name=file, data=data) for file, data in scene.files.items()]
    request = pack.Upload(scene_name=name, file_datas=datas, method=pack.Upload.kFull)
    with _progress(library.chassis, f"uploading {printable(name)}", size):
        await library.request(request)
    if name not in await library.scenes():
        raise ToolError(f"the robot accepted scene {name} but does not list it")
    print(printable(f"uploaded scene {name}: files {len(scene.files)}"), flush=True)


def _scene_of(name: str, known: dict[str, list[str]]) -> str:
    """Return the scene with a name, or else the only scene with a map of this name."""
    if name in known:
        return name
    found = [scene for scene, maps in known.items() if name in maps]
    if not found:
        scenes = ", ".join(known) or "none"
        raise ToolError(f"the robot has no scene and no map {name}: its scenes are {scenes}")
    if len(found) > 1:
        raise ToolError(f"several scenes have map {name}: name one of them: {', '.join(found)}")
    return found[0]


def _check_exists(known: dict[str, list[str]], scene: str, map_name: str) -> str:
    """Check that the robot has a scene, or a map of it if `map_name` is not empty.

    Return words for the scene or the map, for messages. Raise `ToolError` if the robot lacks it.
    """
    if scene not in known:
        scenes = ", ".join(known) or "none"
        raise ToolError(f"the robot has no scene {scene}: its scenes are {scenes}")
    if map_name and map_name not in known[scene]:
        maps = ", ".join(known[scene]) or "none"
        raise ToolError(f"scene {scene} has no map {map_name}: its maps are {maps}")
    return f"map {map_name} of scene {scene}" if map_name else f"scene {scene}"


def _count(storages: Storages) -> int:
    """Return the number of marks in a message that has one field for each type of mark."""
    return sum(len(group) for _, group in storages.ListFields())
