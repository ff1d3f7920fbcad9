"""Actions that bring maps to the robot, enable and delete them."""

from __future__ import annotations

import asyncio

from woosh_robot_agent.pb.map.map_pack_pb2 import Delete, Upload
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.util.common_pb2 import FileData
from woosh_robot_agent.vda5050.actions.errors import ActionFailedError, Objection
from woosh_robot_agent.vda5050.actions.map_files import (
    HASHES,
    MapFileError,
    fetch,
    is_link,
    unpack,
)
from woosh_robot_agent.vda5050.actions.own_thread import in_thread
from woosh_robot_agent.vda5050.actions.performer import Context, PlainPerformer, Report
from woosh_robot_agent.vda5050.model.errors import ErrorType
from woosh_robot_agent.vda5050.model.factsheet import STANDSTILL, ActionType, ParameterType, Scope
from woosh_robot_agent.vda5050.model.order import Action
from woosh_robot_agent.vda5050.model.state import ActionStatus
from woosh_robot_agent.vda5050.robot.maps import StoredMap

_TIMEOUT = 10.0
"""Maximum time until the robot reports its new map after it has accepted it, in seconds."""
_MAP_ID = ParameterType("mapId", "STRING", "name of the map")
_MAP_VERSION = ParameterType("mapVersion", "STRING", "version of the map")
_LINK = "mapDownloadLink"
_HASH = "mapHash"


async def switch_map(context: Context, name: str, version: str | None = None) -> None:
    """Let the robot use a map, unless it does already.

    Args:
        context: objects that all actions share.
        name: name of the map.
        version: version that the map must have; None for any.

    Raises:
        ActionFailedError: there is no such map, or the robot refused it.
        LinkError: the robot could not be reached.
    """
    await context.maps.read()
    found = [each for each in context.maps.find(name, version) if _is_current(context, each)]
    if found:
        return
    chosen = _single(context, name, version)
    context.require_no_leg()
    await context.request(SwitchMap(scene_name=chosen.scene, map_name=chosen.name))
    if not await context.conditions.wait(lambda: _is_current(context, chosen), _TIMEOUT):
        raise ActionFailedError(f"the robot does not report that it uses the map {name}")
    # a robot that stands does not push its pose, which now belongs to this map
    answer = await context.chassis.request(context.requests.empty(PoseSpeed))
    if isinstance(answer.body, PoseSpeed):
        context.facts.remember_pose(answer.body)


class EnableMap(PlainPerformer):
    """Lets the robot use a map."""

    type = ActionType(
        "enableMap",
        frozenset({Scope.INSTANT, Scope.NODE}),
        "use a map, instead of the one that is used now; the position stays the same",
        (_MAP_ID, _MAP_VERSION),
        blocking=STANDSTILL,
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        given = action.parameters
        await switch_map(self._context, given["mapId"], given["mapVersion"])
        return ""


class DeleteMap(PlainPerformer):
    """Deletes a map on the robot."""

    type = ActionType(
        "deleteMap",
        frozenset({Scope.INSTANT}),
        "delete a map that is not used now",
        (_MAP_ID, _MAP_VERSION),
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        context, given = self._context, action.parameters
        await context.maps.read()
        found = _single(context, given["mapId"], given["mapVersion"])
        if _is_current(context, found):
            raise ActionFailedError(f"the robot uses the map {found.name}: enable another one")
        is_last = len(context.maps.of_scene(found.scene)) == 1
        name = "" if is_last else found.name  # no scene is empty: delete it with its last map
        await context.request(Delete(scene_name=found.scene, map_name=name))
        await context.maps.read()
        return ""


class DownloadMap(PlainPerformer):
    """Fetches the files of a scene, and stores them on the robot."""

    type = ActionType(
        "downloadMap",
        frozenset({Scope.INSTANT}),
        "fetch a map, and store it on the robot in a scene of its name",
        (
            _MAP_ID,
            _MAP_VERSION,
            ParameterType(
                _LINK, "STRING", "http or https URL of a ZIP file with the files of a scene"
            ),
            ParameterType(
                _HASH, "STRING", f"hash of the ZIP file in hexadecimal: {', '.join(HASHES)}", True
            ),
        ),
        repeatable=True,
    )

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._one_at_a_time = asyncio.Lock()

    def check(self, action: Action) -> Objection | None:
        given = action.parameters
        if not is_link(given[_LINK]):
            return Objection(f"{_LINK} must be an http or https URL", _LINK)
        if _HASH in given and len(given[_HASH]) not in HASHES.values():
            return Objection(f"{_HASH} must be a hash of {', '.join(HASHES)}", _HASH)
        return None

    async def perform(self, action: Action, report: Report) -> str:
        report(ActionStatus.INITIALIZING)
        async with self._one_at_a_time:
            return await self._download(action, report)

    async def _download(self, action: Action, report: Report) -> str:
        context, given = self._context, action.parameters
        name, version = given["mapId"], given["mapVersion"]
        await context.maps.read()
        self._check_is_new(name)
        report(ActionStatus.RUNNING)
        try:
            link, expected = given[_LINK], given.get(_HASH, "")
            files = await in_thread(lambda: unpack(fetch(link, expected)))
        except MapFileError as error:
            raise ActionFailedError(str(error)) from None
        datas = [FileData(name=each, data=content) for each, content in files.items()]
        await context.request(Upload(scene_name=name, file_datas=datas, method=Upload.kFull))
        await context.maps.read()
        stored = [each for each in context.maps.of_scene(name) if each.name == name]
        if not stored or stored[0].version not in (version, ""):
            await context.request(Delete(scene_name=name))
            await context.maps.read()
            what = f"version {stored[0].version} of the map" if stored else "no map of this name"
            raise ActionFailedError(f"the file has {what}, not version {version} of {name}")
        return ""

    def _check_is_new(self, name: str) -> None:
        """Check that the download replaces nothing.

        Raises:
            ActionFailedError: it would.
        """
        library = self._context.maps
        if library.find(name) or library.of_scene(name):
            raise ActionFailedError(
                f"the robot has a map or scene {name} already, and keeps one version of a map: "
                "delete it first",
                ErrorType.DUPLICATE_MAP,
            )


def _single(context: Context, name: str, version: str | None) -> StoredMap:
    """Return the map with a name and version.

    Raises:
        ActionFailedError: there is none, or several scenes have one.
    """
    found = context.maps.find(name, version)
    if len(found) == 1:
        return found[0]
    what = f"map {name}" if version is None else f"version {version} of the map {name}"
    if not found:
        raise ActionFailedError(f"the robot has no {what}")
    scenes = ", ".join(each.scene for each in found)
    raise ActionFailedError(f"several scenes of the robot have {what}: {scenes}; rename one")


def _is_current(context: Context, stored: StoredMap) -> bool:
    info = context.facts.info
    return info is not None and (info.scene.scene_name, info.scene.map_name) == (
        stored.scene,
        stored.name,
    )
