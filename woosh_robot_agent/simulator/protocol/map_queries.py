"""Handlers of the queries about the files of scenes and about marks."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping

from google.protobuf.message import Message

from woosh_robot_agent.pb.map import map_pack_pb2, storage_edit_pb2
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import Handlers, named_mark, named_scene
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.marks import storage_of, storages_of
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.scenes.writing import files_of


def _download(chassis: Chassis, request: map_pack_pb2.Download) -> Message:
    files = files_of(named_scene(chassis, request.scene_name)).all
    return map_pack_pb2.DownloadResponse(file_datas=_file_datas(files.items()))


def _scene_md5(chassis: Chassis, request: map_pack_pb2.SceneMd5) -> Message:
    name = request.scene_name
    scenes = [named_scene(chassis, name)] if name else chassis.scenes.values()
    return map_pack_pb2.SceneMd5Response(scenes=map(_sums, scenes))


def _sums(scene: Scene) -> map_pack_pb2.SceneFileMD5:
    files = files_of(scene)
    return map_pack_pb2.SceneFileMD5(
        scene_name=scene.name,
        scenes_md5s=_file_sums(files.shared),
        maps=[
            map_pack_pb2.SceneFileMD5.MapFileInfo(
                map_name=area.name,
                version=area.version,
                map_md5s=_file_sums(files.of_maps[area.name]),
            )
            for area in scene.maps
        ],
    )


def _scene_sync(chassis: Chassis, request: map_pack_pb2.SceneSync) -> Message:
    found: dict[tuple[str, str], bytes] = {}
    for wanted in request.scenes:
        scene = named_scene(chassis, wanted.scene_name)
        files = files_of(scene).all
        sums = [*wanted.scenes_md5s, *(each for area in wanted.maps for each in area.map_md5s)]
        for name in dict.fromkeys(each.name for each in sums):
            if name not in files:
                raise RefusedError(refusals.UNKNOWN_FILE, file=name, scene=scene.name)
            found[scene.name, name] = files[name]
    files_found = [(name, data) for (_, name), data in found.items()]
    return map_pack_pb2.SceneSyncResponse(file_datas=_file_datas(files_found))


def _find(chassis: Chassis, request: storage_edit_pb2.Find) -> Message:
    return storage_of(named_mark(chassis, request.no))


def _storages(chassis: Chassis, request: storage_edit_pb2.Storages) -> Message:
    return storages_of(chassis.map.marks.values())


def _file_datas(files: Iterable[tuple[str, bytes]]) -> list[common_pb2.FileData]:
    return [common_pb2.FileData(name=name, data=data) for name, data in files]


def _file_sums(files: Mapping[str, bytes]) -> list[common_pb2.FileMD5]:
    return [
        common_pb2.FileMD5(name=name, md5=hashlib.md5(data, usedforsecurity=False).hexdigest())
        for name, data in files.items()
    ]


HANDLERS: Handlers = {
    map_pack_pb2.Download: _download,
    map_pack_pb2.SceneMd5: _scene_md5,
    map_pack_pb2.SceneSync: _scene_sync,
    storage_edit_pb2.Find: _find,
    storage_edit_pb2.Storages: _storages,
}
