"""Handlers of requests about scenes, maps and marks: read, upload, make, change and delete."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Mapping

from google.protobuf.message import Message

from woosh_robot_agent.pb.map import map_pack_pb2, mark_pb2, storage_edit_pb2
from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.mapping import require_name
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import scene_files
from woosh_robot_agent.simulator.protocol.handlers import (
    command,
    named_mark,
    named_scene,
    pose,
    query,
)
from woosh_robot_agent.simulator.protocol.reports import pose2d
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.files import MAX_SCENES
from woosh_robot_agent.simulator.scenes.robot_files import MAX_MARKS
from woosh_robot_agent.simulator.scenes.scene import (
    Scene,
    files_of,
    free_id,
    has_pose,
    mark_of,
    storage_of,
    storages_of,
    with_map_renamed,
    without_map,
)
from woosh_robot_agent.simulator.timeline import copy_of
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map, Mark


@command(pack.SwitchMap)
def _switch_map(chassis: Chassis, request: pack.SwitchMap) -> None:
    """Switch to a map, whose files may come with the request."""
    _require_idle(chassis)
    if request.file_datas:
        name = request.scene_name or chassis.scene.name
        old = _old_scene(chassis, name)
        scene = scene_files.updated_scene(name, old, request.file_datas)
    else:
        name = request.scene_name or _scene_of_map(chassis, request.map_name)
        scene = named_scene(chassis, name)
    map_name = request.map_name or scene_files.first_map(scene, request.file_datas)
    chassis.switch_map(scene, _named_map(scene, map_name))


def _scene_of_map(chassis: Chassis, map_name: str) -> str:
    """Return the name of the scene that has a map.

    That is the current scene if it has the map, or if no scene has it, or if no map is named.
    """
    if not map_name or chassis.scene.map(map_name):
        return chassis.scene.name
    names = [scene.name for scene in chassis.scenes.values() if scene.map(map_name)]
    if len(names) > 1:
        raise RefusedError(f"scenes {', '.join(names)} have a map {map_name}: name the scene too")
    return names[0] if names else chassis.scene.name


@command(map_pack_pb2.Upload)
def _upload(chassis: Chassis, request: map_pack_pb2.Upload) -> None:
    """Add a scene or change it by uploaded files, without switching to it."""
    if not request.file_datas:
        raise RefusedError("the upload has no files: give at least one")
    name = request.scene_name or chassis.scene.name
    old = _old_scene(chassis, name)
    if old is chassis.scene:
        _require_idle(chassis)
    full = request.method == map_pack_pb2.Upload.kFull
    scene = scene_files.updated_scene(name, old, request.file_datas, replace=full)
    if old is chassis.scene and scene.map(chassis.map.name) is None:
        raise RefusedError(
            f"the upload has no map {chassis.map.name}, which the robot is on: add it, or "
            "switch to another scene first"
        )
    chassis.replace_scene(old, scene)


@command(map_pack_pb2.Rename)
def _rename(chassis: Chassis, request: map_pack_pb2.Rename) -> None:
    """Rename a scene, a map, or both."""
    chassis.mapping.require_none(refusals.MAP_CHANGE_WHILE_MAPPING)
    old = new = named_scene(chassis, request.old_scene_name)
    current_map = chassis.map.name
    if request.old_map_name:
        area = _named_map(old, request.old_map_name)
        new = _with_map_renamed(old, area, request.new_map_name)
        if area is chassis.map:
            current_map = request.new_map_name
    elif request.new_map_name:
        raise RefusedError(refusals.NO_NAME, field="old_map_name")
    if request.new_scene_name or not request.old_map_name:  # without a map: rename the scene
        scene_name = request.new_scene_name
        require_name("new_scene_name", scene_name)
        if scene_name != old.name and scene_name in chassis.scenes:
            raise RefusedError(f"scene {scene_name} exists already: choose another name")
        new = dataclasses.replace(new, name=scene_name)
    chassis.replace_scene(old, new, current_map)


def _with_map_renamed(scene: Scene, area: Map, name: str) -> Scene:
    """Return a scene in which a map has another name; raise RefusedError for a bad name."""
    require_name("new_map_name", name)
    if name == area.name:
        return scene
    if scene.map(name):
        raise RefusedError(refusals.MAP_EXISTS, map=name, scene=scene.name)
    return with_map_renamed(scene, area, name)


@command(map_pack_pb2.Delete)
def _delete(chassis: Chassis, request: map_pack_pb2.Delete) -> None:
    """Delete a scene, or one map of a scene: of the current one if no scene is named."""
    if not request.scene_name and not request.map_name:
        raise RefusedError(refusals.NO_NAME, field="scene_name")
    scene = named_scene(chassis, request.scene_name)
    if not request.map_name:
        if scene is chassis.scene:
            raise RefusedError(f"the robot is in scene {scene.name}: switch to another one first")
        del chassis.scenes[scene.name]
        return
    area = _named_map(scene, request.map_name)
    if area is chassis.map:
        raise RefusedError(f"the robot is on map {area.name}: switch to another one first")
    if len(scene.maps) == 1:
        raise RefusedError(
            f"map {area.name} is the only one of scene {scene.name}: delete the scene instead"
        )
    chassis.replace_scene(scene, without_map(scene, area))


def _require_map_changeable(chassis: Chassis) -> None:
    """Require that the current map may change: nothing that depends on it runs or is paused."""
    # A paused task or navigation would continue to a target on the old map.
    if chassis.tasks.paused:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_PAUSED, task=chassis.tasks.proc.robot_task_id)
    if chassis.tasks.active or chassis.tasks.between_tasks:
        raise RefusedError(refusals.MAP_CHANGE_DURING_TASK)
    if chassis.ownership.driver:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_DRIVING, driver=chassis.ownership.driver)
    if chassis.ownership.navigation:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_NAVIGATION_PAUSED)


def _require_idle(chassis: Chassis) -> None:
    """Raise RefusedError if the current map must not change now, or a map is being made."""
    _require_map_changeable(chassis)
    chassis.mapping.require_none(refusals.MAP_CHANGE_WHILE_MAPPING)


def _named_map(scene: Scene, name: str) -> Map:
    """Return the map called `name` of a scene, or its first map if `name` is empty."""
    area = scene.map(name)
    if area is None:
        maps = ", ".join(each.name for each in scene.maps)
        raise RefusedError(f"unknown map {name} of scene {scene.name}, which has {maps}")
    return area


def _old_scene(chassis: Chassis, name: str) -> Scene | None:
    """Return the scene that an upload changes, or None if the upload adds a scene."""
    old = chassis.scenes.get(name)
    if not old:
        if len(chassis.scenes) >= MAX_SCENES:
            raise RefusedError(refusals.TOO_MANY_SCENES, limit=MAX_SCENES)
        require_name("scene_name", name)
    return old


@query(map_pack_pb2.Download)
def _download(chassis: Chassis, request: map_pack_pb2.Download) -> Message:
    files = files_of(named_scene(chassis, request.scene_name)).all
    return map_pack_pb2.DownloadResponse(file_datas=_file_datas(files.items()))


@query(map_pack_pb2.SceneMd5)
def _scene_md5(chassis: Chassis, request: map_pack_pb2.SceneMd5) -> Message:
    name = request.scene_name
    scenes = [named_scene(chassis, name)] if name else chassis.scenes.values()
    return map_pack_pb2.SceneMd5Response(scenes=map(_scene_md5s, scenes))


def _scene_md5s(scene: Scene) -> map_pack_pb2.SceneFileMD5:
    """Return the MD5 sums of all files of a scene."""
    files = files_of(scene)
    return map_pack_pb2.SceneFileMD5(
        scene_name=scene.name,
        scenes_md5s=_file_md5s(files.shared),
        maps=[
            map_pack_pb2.SceneFileMD5.MapFileInfo(
                map_name=area.name,
                version=area.version,
                map_md5s=_file_md5s(files.of_maps[area.name]),
            )
            for area in scene.maps
        ],
    )


@query(map_pack_pb2.SceneSync)
def _scene_sync(chassis: Chassis, request: map_pack_pb2.SceneSync) -> Message:
    """Return the requested files, each once per scene."""
    # By scene and file name, because files of two scenes may have the same name.
    files_of_scenes: dict[tuple[str, str], bytes] = {}
    for wanted in request.scenes:
        scene = named_scene(chassis, wanted.scene_name)
        files = files_of(scene).all
        requested = [*wanted.scenes_md5s]
        for area in wanted.maps:
            requested += area.map_md5s
        for name in (file.name for file in requested):
            if name not in files:
                raise RefusedError(
                    f"scene {scene.name} has no file {name}; SceneMd5 lists its files"
                )
            files_of_scenes[scene.name, name] = files[name]
    answered = [(name, data) for (_scene, name), data in files_of_scenes.items()]
    return map_pack_pb2.SceneSyncResponse(file_datas=_file_datas(answered))


def _file_datas(files: Iterable[tuple[str, bytes]]) -> list[common_pb2.FileData]:
    return [common_pb2.FileData(name=name, data=data) for name, data in files]


def _file_md5s(files: Mapping[str, bytes]) -> list[common_pb2.FileMD5]:
    return [
        common_pb2.FileMD5(name=name, md5=hashlib.md5(data, usedforsecurity=False).hexdigest())
        for name, data in files.items()
    ]


@command(pack.BuildMap)
def _build_map(chassis: Chassis, request: pack.BuildMap) -> None:
    """Start to make or to update a map, save it, or cancel it."""
    mapping, kind = chassis.mapping, request.type
    if kind in (pack.BuildMap.kAdd, pack.BuildMap.kUpdate):
        _require_map_changeable(chassis)
        start = mapping.add if kind == pack.BuildMap.kAdd else mapping.update
        duration = start(request.scene_name, request.map_name)
    elif kind == pack.BuildMap.kSave:
        duration = mapping.save()
    elif kind == pack.BuildMap.kCanel:  # cancel; the misspelling is that of the schema
        duration = mapping.cancel()
    else:
        raise RefusedError(f"unknown type {kind} of BuildMap: 1 is add, 2 update, 3 cancel, 4 save")
    # The answer comes when the map is started, saved or cancelled.
    chassis.answer_delay = duration


@command(pack.Deployment)
def _deployment(chassis: Chassis, request: pack.Deployment) -> Message:
    if (request.type, request.mode) != (pack.kMark, pack.kDepCollect):
        raise RefusedError("this chassis collects marks only: send type 4 (mark), mode 1 (collect)")
    given = pose(request.pose)
    # Some clients send an empty pose if they mean the pose of the robot.
    mark = chassis.mapping.collect_mark(None if given == Pose() else given)
    marker = pack.DeploymentResponse.Marker(id=mark.id, pose=pose2d(mark.pose))
    return pack.DeploymentResponse(
        type=request.type, mode=request.mode, markers=[marker], check_times=1
    )


_MAX_MARK_NUMBER = 100
"""Maximum length of the number of a mark, in characters."""

_MAX_MARK = 4096
"""Maximum size of the data of a mark, in bytes."""


@query(storage_edit_pb2.Find)
def _find_mark(chassis: Chassis, request: storage_edit_pb2.Find) -> Message:
    return storage_of(named_mark(chassis, request.no))


@query(storage_edit_pb2.Storages)
def _storages(chassis: Chassis, request: storage_edit_pb2.Storages) -> Message:
    return storages_of(chassis.map.marks.values())


@command(storage_edit_pb2.Create)
def _create_mark(chassis: Chassis, request: storage_edit_pb2.Create) -> Message:
    area, storage = chassis.map, copy_of(request.storage)  # a copy: tests read the request as sent
    if len(area.marks) >= MAX_MARKS:
        raise RefusedError(f"map {area.name} has {MAX_MARKS} marks already: delete one first")
    if storage.identity.no in area.marks:
        raise RefusedError(
            f"mark {storage.identity.no} of map {area.name} exists already: choose another "
            "number, or update it"
        )
    if not storage.identity.id:
        storage.identity.id = free_id(mark.id for mark in area.marks.values())
    mark = _checked_mark(chassis, storage)
    _store_marks(chassis, [*area.marks.values(), mark])
    return storage_of(mark)


@command(storage_edit_pb2.Update)
def _update_mark(chassis: Chassis, request: storage_edit_pb2.Update) -> None:
    """Change the mark with the given number; if no mark has it, renumber the mark with the id."""
    area, changes = chassis.map, request.storage
    number, id_ = changes.identity.no, changes.identity.id
    by_id = next((mark for mark in area.marks.values() if id_ and mark.id == id_), None)
    old = area.marks.get(number) or by_id or named_mark(chassis, number)
    storage = storage_of(old)
    # A given field replaces the old one, and a given category replaces another category.
    for field, _ in changes.ListFields():
        if field.containing_oneof:
            storage.ClearField(storage.WhichOneof(field.containing_oneof.name) or field.name)
        else:
            storage.ClearField(field.name)
    storage.MergeFrom(changes)
    storage.identity.id = id_ or old.id
    mark = _checked_mark(chassis, storage, old)
    _store_marks(chassis, [mark if each is old else each for each in area.marks.values()])


@command(storage_edit_pb2.Delete)
def _delete_mark(chassis: Chassis, request: storage_edit_pb2.Delete) -> None:
    old = named_mark(chassis, request.no)
    _store_marks(chassis, [each for each in chassis.map.marks.values() if each is not old])


def _checked_mark(chassis: Chassis, storage: mark_pb2.Storage, old: Mark | None = None) -> Mark:
    """Check the mark that a client has described, and return it.

    Args:
        chassis: the robot, on whose current map the mark is.
        old: the mark that it replaces, None for a new mark.
    """
    area, number = chassis.map, storage.identity.no
    if not number:
        raise RefusedError("the mark has no number: set identity.no")
    if len(number) > _MAX_MARK_NUMBER:
        raise RefusedError(refusals.TEXT_TOO_LONG, field="identity.no", limit=_MAX_MARK_NUMBER)
    if storage.ByteSize() > _MAX_MARK:
        raise RefusedError(
            f"the data of mark {number} have {storage.ByteSize()} bytes, more than "
            f"{_MAX_MARK}: send fewer"
        )
    if not has_pose(storage):
        raise RefusedError(f"mark {number} has no pose: set pose.dock")
    for other in area.marks.values():
        if other is not old and other.id == storage.identity.id:
            raise RefusedError(
                f"mark {other.number} of map {area.name} has the id {other.id} already: use 0 "
                "for a free one"
            )
    mark = mark_of(storage)
    if not area.contains(*mark.pose.point):
        raise RefusedError(f"mark {number} is outside map {area.name}: choose a pose inside")
    return mark


def _store_marks(chassis: Chassis, marks: list[Mark]) -> None:
    chassis.change_map(marks={mark.number: mark for mark in marks})
