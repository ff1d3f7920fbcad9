"""Nav2's services: the states of its nodes and of their managers, and its map server."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import PurePosixPath
from typing import Any

from lifecycle_msgs.msg import State
from nav2_msgs import srv as nav2_services
from nav_msgs.msg import OccupancyGrid

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link import LinkError, LinkState
from woosh_robot_agent.motion import Sender
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneList
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, Scene
from woosh_robot_agent.robot.maps import find_map, scene_data
from woosh_robot_agent.robot.readiness import objections_except_busy
from woosh_robot_agent.ros.bridge import Reply
from woosh_robot_agent.ros.qos import RARE_QOS
from woosh_robot_agent.ros.standard.map import grid
from woosh_robot_agent.ros.standard.part import PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.ros.standard_endpoints import BY_NAME, CLEARING, MANAGERS

_LOG = logging.getLogger(__name__)


class Lifecycle:
    """Services with the states of Nav2's nodes, for clients that wait until these are active."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        for node, manager, is_active in (
            ("bt_navigator", MANAGERS[0], self._accepts_tasks),
            # even if the robot does not know its pose: clients wait for amcl before they set it
            ("amcl", MANAGERS[1], self._is_connected),
        ):
            create_service(context, f"{node}/get_state", partial(_get_state, is_active))
            create_service(context, f"{manager}/is_active", partial(_is_active, is_active))
            create_service(context, f"{manager}/manage_nodes", partial(_manage, manager, is_active))

    def _is_connected(self) -> bool:
        return self._context.chassis.state is LinkState.READY

    def _accepts_tasks(self) -> bool:
        """Return True if the robot accepts tasks, or will do so after its current task."""
        info = self._context.last_known.value(RobotInfo)
        if info is None or not self._is_connected():
            return False
        return not objections_except_busy(info)


async def _get_state(is_active: Callable[[], bool], _request: Any, response: Any) -> None:
    active = is_active()
    response.current_state.id = (
        State.PRIMARY_STATE_ACTIVE if active else State.PRIMARY_STATE_INACTIVE
    )
    response.current_state.label = "active" if active else "inactive"


async def _is_active(is_active: Callable[[], bool], _request: Any, response: Any) -> None:
    response.success = is_active()


async def _manage(manager: str, is_active: Callable[[], bool], request: Any, response: Any) -> None:
    """Answer a request to start or stop nodes. It changes nothing.

    A startup or resume succeeds if the nodes are active; all other commands fail.
    """
    response.success = request.command in (request.STARTUP, request.RESUME) and is_active()
    if not response.success:
        _LOG.warning(
            "%s: command %d is not possible: the robot navigates by itself; startup and resume "
            "succeed while %s/is_active returns true",
            manager,
            request.command,
            manager,
        )


_SUFFIXES = (".yaml", ".yml", ".png", ".pgm")
"""Suffixes of the files of a map."""
_SWITCH_TIMEOUT = 10.0
"""Maximum time until the robot reports its new map, in seconds."""
_CHECK_PERIOD = 0.1
"""Period of the checks of the reported map, in seconds."""


class MapServer:
    """Services that return the robot's current map, and switch to another map."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        create_service(context, "map_server/map", self._get)
        create_service(context, "map_server/load_map", self._load)

    async def _get(self, _request: Any, response: Any) -> None:
        response.map = await self._grid()

    async def _load(self, request: Any, response: Any) -> None:
        file = PurePosixPath(request.map_url)
        name = file.stem if file.suffix in _SUFFIXES else file.name  # a name may have a dot
        response.result = response.RESULT_UNDEFINED_FAILURE
        try:
            response.result = await self._switch(name, response)
        except LinkError as error:
            _LOG.error("map_server/load_map: the map %s is not loaded: %s", name, error)
        if response.result == response.RESULT_SUCCESS:
            response.map = await self._grid()

    async def _switch(self, name: str, response: Any) -> int:
        """Switch the robot to a map; return a result code of nav2_msgs/LoadMap.

        Raises:
            LinkError: the chassis does not answer.
        """
        if not name:
            return int(response.RESULT_MAP_DOES_NOT_EXIST)
        if self._scene.map_name == name and self._context.chassis.state is LinkState.READY:
            return int(response.RESULT_SUCCESS)
        scene_name = await self._scene_of(name)
        if scene_name is None:
            return int(response.RESULT_MAP_DOES_NOT_EXIST)
        answer = await self._context.gate.request(
            SwitchMap(scene_name=scene_name, map_name=name),
            sender=Sender("map_server/load_map"),
        )
        if not answer.ok:  # `RefusalLog` logs the refusals of all commands
            return int(response.RESULT_UNDEFINED_FAILURE)
        clock = asyncio.get_running_loop().time
        until = clock() + _SWITCH_TIMEOUT
        while self._scene.map_name != name:
            if clock() > until:
                _LOG.error(
                    "map_server/load_map: the robot does not report that it uses the map %s", name
                )
                return int(response.RESULT_UNDEFINED_FAILURE)
            await asyncio.sleep(_CHECK_PERIOD)
        _LOG.info("the robot uses the map %s; set its pose, e.g. by initialpose", name)
        return int(response.RESULT_SUCCESS)

    async def _scene_of(self, name: str) -> str | None:
        """Return the scene of a map, preferably the current one.

        If no scene has the map, or several others have it, log that and return None.

        Raises:
            LinkError: the chassis does not answer.
        """
        current = self._scene.scene_name
        answer = await self._context.chassis.request(SceneList())
        if not answer.ok or not isinstance(answer.body, SceneList):
            return current  # the firmware does not list scenes
        scenes = {each.name: list(each.maps) for each in answer.body.scenes}
        with_map = [scene for scene, maps in scenes.items() if name in maps]
        if current in with_map:
            return current
        if len(with_map) == 1:
            return with_map[0]
        known = ", ".join(f"{each} ({scene})" for scene, maps in scenes.items() for each in maps)
        problem = (
            f"several scenes have a map {name}" if with_map else f"the robot has no map {name}"
        )
        _LOG.error("map_server/load_map: %s; its maps and their scenes are %s", problem, known)
        return None

    @property
    def _scene(self) -> Scene:
        return self._context.last_known.value(Scene) or Scene()

    async def _grid(self) -> OccupancyGrid:
        """Return the map that the robot uses; blank if it cannot be read."""
        scene = self._scene
        try:
            data = await scene_data(self._context.chassis, scene.scene_name)
            area = find_map(data, scene.map_id, scene.map_name)
            origin = Pose2D.from_message(area.origin)
            return await grid(self._context, area.map_png, area.resolution, origin)
        except (LinkError, ValueError) as error:
            _LOG.warning("map_server: no map: %s", error)
            return OccupancyGrid()


class Costmaps:
    """The services that clear costmaps. They do nothing: the robot keeps no costmap for clients.

    Programs call them before they repeat a navigation that failed, and wait for the answer.
    """

    def __init__(self, context: PartContext) -> None:
        self._is_logged = False
        """True once a log message has said that clearing has no effect."""
        for name, type_name in CLEARING.items():
            if hasattr(nav2_services, type_name):  # not all releases of Nav2 have all types
                create_service(context, name, partial(self._clear, name))

    async def _clear(self, name: str, _request: Any, _response: Any) -> None:
        if not self._is_logged:
            self._is_logged = True
            _LOG.info("%s has no effect: the robot notes obstacles by itself", name)


def create_service(
    context: PartContext, name: str, answer: Callable[[Any, Any], Coroutine[Any, Any, None]]
) -> None:
    """Create one of Nav2's services.

    Args:
        answer: fills the response to a request, in the link thread.
    """
    response_class = class_of(BY_NAME[name].type, "srv").Response

    async def work(request: Any, reply: Reply) -> None:
        response = response_class()
        await answer(request, response)
        reply.send(response)

    def handle(request: Any, reply: Reply) -> None:
        context.thread.spawn(partial(work, request, reply), reply.fail)

    context.service(name, handle, qos=RARE_QOS)
