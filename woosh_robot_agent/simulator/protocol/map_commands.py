"""Handler of SwitchMap, which changes the map and uploads scenes."""

from __future__ import annotations

import dataclasses

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import uploads
from woosh_robot_agent.simulator.protocol.handlers import (
    Handlers,
    Result,
    named_scene,
    require_map_change,
)
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.library import MAX_SCENES
from woosh_robot_agent.simulator.scenes.scene import Scene


def _switch_map(chassis: Chassis, request: pack.SwitchMap) -> Result:
    require_map_change(chassis)
    chassis.mapping.require_none(refusals.MAP_CHANGE_WHILE_MAPPING)
    name = request.scene_name or chassis.scene.name
    if request.file_datas:
        scene = _with_files(chassis, name, request)
    else:
        scene = named_scene(chassis, name)
    wanted = request.map_name or uploads.first_map(scene, request.file_datas)
    area = scene.map(wanted)
    if area is None:
        maps = ", ".join(each.name for each in scene.maps)
        raise RefusedError(refusals.UNKNOWN_MAP, map=wanted, scene=name, maps=maps)
    chassis.enter(scene, area)
    chassis.deployment.end_session()
    return None


def _with_files(chassis: Chassis, name: str, request: pack.SwitchMap) -> Scene:
    """Return the scene after an upload."""
    old = chassis.scenes.get(name)
    if not old and len(chassis.scenes) >= MAX_SCENES:
        raise RefusedError(refusals.TOO_MANY_SCENES, limit=MAX_SCENES)
    files = uploads.merge_files(old.files if old else {}, request.file_datas)
    scene = uploads.updated_scene(name, old, files)
    if scene:
        return scene
    # No file describes the new scene: it gets the current map under a new name.
    area = dataclasses.replace(chassis.map, name=request.map_name or name, version=1)
    return dataclasses.replace(chassis.scene, name=name, maps=[area], files=files)


HANDLERS: Handlers = {pack.SwitchMap: _switch_map}
