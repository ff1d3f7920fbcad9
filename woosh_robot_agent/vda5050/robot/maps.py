"""The maps on the robot, and their marks, i.e. numbered places to which it can drive."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from dataclasses import dataclass

from woosh_robot_agent.link import ConnectionLostError, LinkError
from woosh_robot_agent.link.reconnect import Backoff
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData, SceneDataEasy, SceneList
from woosh_robot_agent.pb.map.mark_pb2 import Pose
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, Scene
from woosh_robot_agent.vda5050.messages.order import NodePosition
from woosh_robot_agent.vda5050.messages.state import Map
from woosh_robot_agent.vda5050.robot.link import RobotLink

_LOG = logging.getLogger(__name__)
_MAX_RETRY_DELAY = 300.0
"""Longest pause before maps and marks are requested again, in seconds."""
_MARKS_WITHIN = 10.0
"""Maximum wait for the marks, in seconds; real robots have taken 5 s."""


@dataclass(frozen=True)
class StoredMap:
    """A map on the robot.

    Attributes:
        scene: name of the scene (folder of maps on the robot) with the map.
        name: name of the map, unique in its scene; the standard's mapId.
        version: version of the map, as a string; empty if the robot does not report it.
    """

    scene: str
    name: str
    version: str

    def is_used(self, info: RobotInfo | None) -> bool:
        """Return True if the robot uses the map, by its last reports; None before the first."""
        used = None if info is None else (info.scene.scene_name, info.scene.map_name)
        return used == (self.scene, self.name)


class RobotMaps:
    """The maps on the robot, and the marks of its scene. Used in the event loop of the link.

    Maps and marks are read at each connection, and when the robot's map changes. After a failure,
    they are requested again, after ever longer pauses.

    Attributes:
        downloading: lock that allows one download at a time.
    """

    def __init__(self, link: RobotLink) -> None:
        self._link = link
        self.downloading = asyncio.Lock()
        self._maps: tuple[StoredMap, ...] | None = None
        """All maps; None until they have been read."""
        self._scene = ""
        """Name of the robot's scene; empty if it has none, or before its first report."""
        self._marks: dict[tuple[str, str], NodePosition] | None = None
        """Positions of the scene's marks, by the id of the map and the number of the mark; None
        until they have been read."""
        self._were_requested = asyncio.Event()
        """Set when a request for the marks of the scene has been answered, or has failed."""
        self._retry = Backoff(link.timing.ask_again_after, _MAX_RETRY_DELAY)
        """Pauses after failed requests."""
        self._loses_link = False
        """True if the link was lost during the last request, e.g. because a scene is too large."""
        self._not_before = -math.inf
        """Loop time before which maps and marks are not requested again."""
        self._log = LogOnce(_LOG)
        link.chassis.on_snapshot(lambda info: self._scene_reported(info.scene))
        link.chassis.subscribe(Scene, self._scene_reported)

    @property
    def knows_marks(self) -> bool:
        """True once the marks of the robot's scene have been read."""
        return self._marks is not None

    def find_mark(self, number: str, map_id: str) -> NodePosition | None:
        """Return the position of a mark, with its heading; None if no such mark is known."""
        return (self._marks or {}).get((map_id, number))

    async def wait_for_marks(self) -> None:
        """Wait for the marks, which an order may need; go on without them if a request fails."""
        with contextlib.suppress(TimeoutError):
            await run_with_timeout(_MARKS_WITHIN, self._were_requested.wait())

    def listed(self, info: RobotInfo) -> tuple[Map, ...] | None:
        """Return the maps for the state message; None if they are unknown.

        Args:
            info: reports of the robot, with the map that it uses now.
        """
        if self._maps is None:
            return None
        return tuple(Map(each.name, each.version, each.is_used(info)) for each in self._maps)

    def find(self, name: str, version: str | None = None) -> list[StoredMap]:
        """Return the maps with a name, and with a version if it is not None.

        A map of unknown version matches any version.
        """
        return [
            each
            for each in self._maps or ()
            if each.name == name and (version is None or each.version in (version, ""))
        ]

    def of_scene(self, scene: str) -> list[StoredMap]:
        return [each for each in self._maps or () if each.scene == scene]

    async def read(self) -> bool:
        """Read the list of maps from the robot; return False, and keep the last, if it refuses.

        Raises:
            LinkError: the robot did not answer.
        """
        answer = await self._link.ask(SceneList())
        if not isinstance(answer.body, SceneList) or not answer.ok:
            self._log.warn("list", f"the robot did not send the list of its maps: {answer.reason}")
            return False
        self._log.clear("list")
        maps: list[StoredMap] = []
        for scene in answer.body.scenes:
            versions = await self._read_versions(scene.name)
            maps += [StoredMap(scene.name, name, versions.get(name, "")) for name in scene.maps]
        if tuple(maps) != self._maps:
            self._maps = tuple(maps)
            self._link.changed()
        return True

    async def _read_versions(self, scene: str) -> dict[str, str]:
        """Return the versions of the maps of a scene, by their names; {} if the robot refuses.

        Raises:
            LinkError: the robot did not answer.
        """
        answer = await self._link.ask(SceneDataEasy(name=scene))
        if not isinstance(answer.body, SceneDataEasy):
            return {}
        return {each.name: str(each.version) for each in answer.body.maps}

    def _scene_reported(self, scene: Scene) -> None:
        """Read maps and marks again; if this is under way already, begin anew."""
        is_other = scene.scene_name != self._scene
        if is_other:
            self._scene, self._marks = scene.scene_name, None
            self._were_requested.clear()
        if is_other or not self._loses_link:  # otherwise the pauses must grow on over reconnects
            self._request_soon()
        self._link.background.start(self._refresh(), self)

    def _request_soon(self) -> None:
        """Let the next request come without a pause."""
        self._retry.reset()
        self._loses_link = False
        self._not_before = -math.inf

    async def _refresh(self) -> None:
        """Read maps and marks; try again until the robot sends them or the link is lost."""
        clock = asyncio.get_running_loop().time
        while True:
            await asyncio.sleep(self._not_before - clock())
            try:
                await self._link.wait_ready()
                self._loses_link = False
                is_listed = await self.read()
                is_complete = await self._read_marks(self._scene) and is_listed
            except LinkError as error:
                is_complete = False
                self._loses_link |= isinstance(error, ConnectionLostError)
                self._log.warn("maps", f"the maps and marks are unknown for now: {error}")
            self._were_requested.set()
            if is_complete:
                self._request_soon()
                self._log.clear()
                return
            self._not_before = clock() + self._retry.next()
            if not self._link.ready:
                return  # maps and marks are read again after a reconnect

    async def _read_marks(self, scene: str) -> bool:
        """Read the marks of a scene; return False, and keep the last ones, if the robot refuses.

        Raises:
            LinkError: the robot did not answer.
        """
        if not scene:
            self._marks = {}
            return True
        answer = await self._link.ask(SceneData(name=scene))
        if not answer.ok or not isinstance(answer.body, SceneData):
            text = f"the marks of scene {scene} are unknown, because the robot sent none"
            self._log.warn("marks", f"{text}: {answer.reason}")
            return False
        self._marks = marks = {}
        for each in answer.body.maps:
            map_id = each.name or str(each.id)
            for mark in each.mark_info.storages:
                if (place := _place(mark.pose, map_id)) is not None:
                    marks[map_id, mark.identity.no] = place
        self._link.changed()
        return True


def _place(pose: Pose, map_id: str) -> NodePosition | None:
    """Return the position of a robot at a mark; None if it is unknown."""
    for name in ("dock", "real"):  # "real" is the mark itself, "dock" where a robot docks at it
        if pose.HasField(name):
            there = getattr(pose, name)
            if all(map(math.isfinite, (there.x, there.y, there.theta))):
                return NodePosition(there.x, there.y, map_id, there.theta)
    return None
