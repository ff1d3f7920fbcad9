"""Handlers of the commands about scenes and maps: change, upload, rename and delete."""

from __future__ import annotations

import dataclasses

from woosh_robot_agent.pb.map import map_pack_pb2
from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import uploads
from woosh_robot_agent.simulator.protocol.handlers import (
    Handlers,
    Result,
    named_map,
    named_scene,
    require_map_change,
)
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.editing import with_map_renamed, without_map
from woosh_robot_agent.simulator.scenes.file_names import MAX_NAME, is_plain
from woosh_robot_agent.simulator.scenes.library import MAX_SCENES
from woosh_robot_agent.simulator.scenes.scene import Scene


def _switch_map(chassis: Chassis, request: pack.SwitchMap) -> Result:
    _require_idle(chassis)
    name = request.scene_name or chassis.scene.name
    if request.file_datas:
        old = _old_scene(chassis, name)
        scene = uploads.updated_scene(name, old, request.file_datas)
        if scene is None:
            # No file describes the new scene: it gets the current map under a new name.
            files = uploads.merge_files({}, request.file_datas)
            area = dataclasses.replace(chassis.map, name=request.map_name or name, version=1)
            scene = dataclasses.replace(
                chassis.scene, name=name, maps=[area], start_map="", files=files
            )
    else:
        scene = named_scene(chassis, name)
    wanted = request.map_name or uploads.first_map(scene, request.file_datas)
    chassis.enter(scene, named_map(scene, wanted))
    chassis.deployment.end_session()
    return None


def _upload(chassis: Chassis, request: map_pack_pb2.Upload) -> Result:
    if not request.file_datas:
        raise RefusedError(refusals.NO_FILES)
    name = request.scene_name or chassis.scene.name
    old = _old_scene(chassis, name)
    if old is None:
        _check_name("scene_name", name)
    if old is chassis.scene:
        _require_idle(chassis)
    uploads.check_pictures(request.file_datas)
    full = request.method == map_pack_pb2.Upload.kFull
    scene = uploads.updated_scene(name, old, request.file_datas, replace=full)
    if scene is None:
        raise RefusedError(refusals.NO_MAP_IN_UPLOAD, scene=name)
    if old is chassis.scene and scene.map(chassis.map.name) is None:
        raise RefusedError(refusals.CURRENT_MAP_MISSING, map=chassis.map.name)
    chassis.replace_scene(old, scene)
    return None


def _rename(chassis: Chassis, request: map_pack_pb2.Rename) -> Result:
    old = named_scene(chassis, request.old_scene_name)
    new, map_name = old, ""
    if request.old_map_name:
        area, map_name = named_map(old, request.old_map_name), request.new_map_name
        _check_name("new_map_name", map_name)
        if map_name != area.name:
            if old.map(map_name):
                raise RefusedError(refusals.MAP_EXISTS, map=map_name, scene=old.name)
            new = with_map_renamed(old, area, map_name)
        if area is not chassis.map:
            map_name = ""
    elif request.new_map_name:
        raise RefusedError(refusals.NO_NAME, field="old_map_name")
    if not request.old_map_name or request.new_scene_name:
        name = request.new_scene_name
        _check_name("new_scene_name", name)
        if name != old.name and name in chassis.scenes:
            raise RefusedError(refusals.SCENE_EXISTS, scene=name)
        new = dataclasses.replace(new, name=name)
    chassis.replace_scene(old, new, map_name)
    return None


def _delete(chassis: Chassis, request: map_pack_pb2.Delete) -> Result:
    if not (request.scene_name or request.map_name):
        raise RefusedError(refusals.NO_NAME, field="scene_name")
    scene = named_scene(chassis, request.scene_name)
    if not request.map_name:
        if scene is chassis.scene:
            raise RefusedError(refusals.CURRENT_SCENE, scene=scene.name)
        del chassis.scenes[scene.name]
        return None
    area = named_map(scene, request.map_name)
    if area is chassis.map:
        raise RefusedError(refusals.CURRENT_MAP, map=area.name)
    if len(scene.maps) == 1:
        raise RefusedError(refusals.LAST_MAP, map=area.name, scene=scene.name)
    chassis.replace_scene(scene, without_map(scene, area))
    return None


def _require_idle(chassis: Chassis) -> None:
    """Check that nothing runs that a change of the current map would disturb.

    Raises:
        RefusedError: Something runs or is paused, or a map is being made.
    """
    require_map_change(chassis)
    chassis.mapping.require_none(refusals.MAP_CHANGE_WHILE_MAPPING)


def _old_scene(chassis: Chassis, name: str) -> Scene | None:
    """Return the scene that an upload changes, or None if the upload adds one."""
    old = chassis.scenes.get(name)
    if not old and len(chassis.scenes) >= MAX_SCENES:
        raise RefusedError(refusals.TOO_MANY_SCENES, limit=MAX_SCENES)
    return old


def _check_name(field: str, name: str) -> None:
    """Check a new name of a scene or map."""
    if not name:
        raise RefusedError(refusals.NO_NAME, field=field)
    if not is_plain(name):
        raise RefusedError(refusals.NAME_INVALID, field=field, name=name[:MAX_NAME], limit=MAX_NAME)


HANDLERS: Handlers = {
    pack.SwitchMap: _switch_map,
    map_pack_pb2.Upload: _upload,
    map_pack_pb2.Rename: _rename,
    map_pack_pb2.Delete: _delete,
}
