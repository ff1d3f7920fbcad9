"""The marks of the robot's scene, read at each connection and when the scene changes."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable

from woosh_robot_agent.link import ChassisClient, LinkError, LinkState
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.map.mark_pb2 import Pose
from woosh_robot_agent.pb.robot.robot_pb2 import Scene
from woosh_robot_agent.vda5050.model.order import NodePosition

_LOG = logging.getLogger(__name__)
_RETRY = 5.0
"""Pause before the marks are requested again after a request without an answer, in seconds."""


class RobotMarks:
    """The marks of the robot's scene. Used in the event loop of the link.

    Args:
        chassis: the link.
        on_changed: called when the marks of a scene have arrived.
    """

    def __init__(self, chassis: ChassisClient, on_changed: Callable[[], None]) -> None:
        self._chassis = chassis
        self._on_changed = on_changed
        self._scene = ("", 0)
        """Name and version of the robot's scene."""
        self._marks: dict[tuple[str, str], NodePosition] = {}
        """Positions of the marks, by the id of the map and the number of the mark."""
        self._request: asyncio.Task[None] | None = None
        self._log = LogOnce(_LOG)
        chassis.on_snapshot(lambda info: self._scene_reported(info.scene))
        chassis.on_state(self._link_changed)
        chassis.subscribe(Scene, self._scene_reported)
        chassis.on_robot_changed(self._forget)

    def find(self, number: str, map_id: str) -> NodePosition | None:
        """Return the position of a mark, with its heading; None if the map has no such mark."""
        return self._marks.get((map_id, number))

    async def close(self) -> None:
        """Stop waiting for an answer."""
        if self._request is not None:
            self._request.cancel()
            await asyncio.gather(self._request, return_exceptions=True)

    def _link_changed(self, state: LinkState) -> None:
        if state is LinkState.READY:
            self._request_marks(self._scene)
        elif self._request is not None:
            self._request.cancel()

    def _scene_reported(self, scene: Scene) -> None:
        before, self._scene = self._scene, (scene.scene_name, scene.version)
        if self._scene[0] != before[0]:
            self._marks = {}
        if self._scene != before and self._chassis.state is LinkState.READY:
            self._request_marks(self._scene)

    def _request_marks(self, scene: tuple[str, int]) -> None:
        if self._request is not None:
            self._request.cancel()
        if not scene[0]:
            return
        self._request = asyncio.get_running_loop().create_task(
            self._read(scene[0]), name="vda5050 marks"
        )

    def _forget(self) -> None:
        self._marks = {}
        self._scene = ("", 0)

    async def _read(self, scene: str) -> None:
        while True:
            try:
                answer = await self._chassis.request(SceneData(name=scene))
                break
            except LinkError as error:
                self._log.warn(scene, f"the marks of scene {scene} are unknown for now: {error}")
            await asyncio.sleep(_RETRY)  # cancelled when the link is lost
        self._log.clear()
        if not answer.ok or not isinstance(answer.body, SceneData):
            _LOG.warning(
                "the marks of scene %s are unknown, because the robot sent none: %s",
                scene,
                answer.msg,
            )
            return
        self._marks = {
            (area.name or str(area.id), storage.identity.no): place
            for area in answer.body.maps
            for storage in area.mark_info.storages
            if (place := _place(storage.pose, area.name or str(area.id))) is not None
        }
        self._on_changed()


def _place(pose: Pose, map_id: str) -> NodePosition | None:
    """Return the position of a robot at a mark; None if it is unknown."""
    for name in ("dock", "real"):
        if pose.HasField(name):
            there = getattr(pose, name)
            if all(map(math.isfinite, (there.x, there.y, there.theta))):
                return NodePosition(there.x, there.y, map_id, there.theta)
    return None
