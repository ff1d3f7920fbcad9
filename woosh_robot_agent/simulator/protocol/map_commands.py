"""Handler of SwitchMap, which changes the map and uploads scenes."""

from __future__ import annotations

import dataclasses

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import uploads
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result, named_scene
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.scene import Scene

_MAX_SCENES = 20
"""Number of known scenes from which on uploads of new ones are refused."""


def _switch_map(chassis: Chassis, request: pack.SwitchMap) -> Result:
    # A paused task or navigation would continue to a target on the old map.
    if chassis.tasks.paused:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_PAUSED, task=chassis.tasks.proc.robot_task_id)
    if chassis.tasks.active:
        raise RefusedError(refusals.MAP_CHANGE_DURING_TASK)
    if chassis.ownership.driver:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_DRIVING, driver=chassis.ownership.driver)
    if chassis.ownership.navigation:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_NAVIGATION_PAUSED)
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
    return None


def _with_files(chassis: Chassis, name: str, request: pack.SwitchMap) -> Scene:
    """Return the scene after an upload."""
    old = chassis.scenes.get(name)
    if not old and len(chassis.scenes) >= _MAX_SCENES:
        raise RefusedError(refusals.TOO_MANY_SCENES, limit=_MAX_SCENES)
    files = uploads.merge_files(old.files if old else {}, request.file_datas)
    scene = uploads.updated_scene(name, old, files)
    if scene:
        return scene
    # No file describes the new scene: it gets the current map under a new name.
    area = dataclasses.replace(chassis.map, name=request.map_name or name, version=1)
    return dataclasses.replace(chassis.scene, name=name, maps=[area], files=files)


HANDLERS: Handlers = {pack.SwitchMap: _switch_map}
