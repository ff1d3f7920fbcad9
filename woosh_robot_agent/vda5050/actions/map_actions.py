"""Actions that download, enable and delete maps, and set the position of the robot on a map."""

from __future__ import annotations

import asyncio
import hashlib
import io
import lzma
import zipfile
import zlib
from pathlib import PurePosixPath
from urllib.parse import urlsplit

import aiohttp

from woosh_robot_agent.pb.map.map_pack_pb2 import Delete, Upload
from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot, SwitchMap
from woosh_robot_agent.pb.util.common_pb2 import FileData, Pose2D
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.actions.performing import (
    INSTANT,
    NOT_ON_EDGES,
    Run,
    vehicle_action,
)
from woosh_robot_agent.vda5050.execution import Execution
from woosh_robot_agent.vda5050.messages.factsheet import NOT_EMPTY, STANDSTILL, ParameterType
from woosh_robot_agent.vda5050.messages.state import ActionFailedError, ActionStatus, ErrorType
from woosh_robot_agent.vda5050.robot.maps import StoredMap

_URL = Sentence("an http or https URL")
_HASH_OF = Sentence("a hash of {kinds}")
_SLOW = Sentence("the download of {link} takes too long")
_NOT_FETCHED = Sentence("{link} cannot be fetched: {error}")
_TOO_LARGE = Sentence("{link} has more than {most} bytes")
_HASH = Sentence("{link} has the {kind} hash {found}, not {given}")
_FILES = Sentence("the ZIP file has {count} files, not 1 to {most}")
_CONTENT = Sentence("the files in the ZIP file have more than {most} bytes")
_NO_ZIP = Sentence("the downloaded file is no usable ZIP file: {error}")
_SAME_NAME = Sentence("two files in the ZIP file have the same name")
_NOT_USED = Sentence("the robot does not report that it uses the map {map}")
_NOT_FOUND = Sentence("the robot has not found its position: see its errors")
_USED = Sentence("the robot uses the map {map}: enable another one")
_EXISTS = Sentence(
    "the robot has a map or scene {map} already, and keeps one version of a map: delete it first"
)
_ITS_VERSION = Sentence("version {version} of the map")
_NO_SUCH_MAP = Sentence("no map of this name")
_OTHER_FILE = Sentence("the file has {what}, not version {version} of {map}")
_MAP = Sentence("map {map}")
_MAP_OF_VERSION = Sentence("version {version} of the map {map}")
_MISSING = Sentence("the robot has no {what}")
_NO_LIST = Sentence("the robot did not send the list of its maps")
_SEVERAL = Sentence("several scenes of the robot have {what}: {scenes}; rename one")

_HASHES = {"sha256": 64, "sha1": 40, "md5": 32}
"""Supported hashes, and their lengths in hexadecimal digits."""
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
)
"""Errors of a ZIP file that is damaged, encrypted or compressed in an unknown way."""
_MAX_SILENCE = 30.0
"""Maximum time of a download without any data, in seconds."""
_MAX_DURATION = 600.0
"""Maximum duration of a download, in seconds."""
_MAX_BYTES = 64 * 1024 * 1024
"""Maximum size of the ZIP file, and of all files in it together, in bytes."""
_MAX_FILES = 200
"""Maximum number of files in the ZIP file."""


def _is_url(text: str) -> bool:
    """Return True if a text is a URL from which a file can be fetched."""
    try:
        parts = urlsplit(text)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and bool(parts.hostname)


async def fetch(url: str, expected_hash: str = "", max_duration: float = _MAX_DURATION) -> bytes:
    """Fetch a file.

    Args:
        url: http or https URL.
        expected_hash: hash of the file in hexadecimal, of a length in `_HASHES`; empty for no
            check.
        max_duration: maximum duration of the download, in seconds.

    Raises:
        ActionFailedError: the file cannot be fetched, is too large or too slow, or has another
            hash.
    """
    data = bytearray()
    timeout = aiohttp.ClientTimeout(max_duration, sock_connect=_MAX_SILENCE, sock_read=_MAX_SILENCE)
    try:
        async with (
            aiohttp.ClientSession(
                timeout=timeout,
                trust_env=True,  # for a proxy
                raise_for_status=True,
                # uncompressed, so that the data cannot grow beyond the limit at once
                headers={"Accept-Encoding": "identity"},
                auto_decompress=False,
            ) as session,
            session.get(url) as response,
        ):
            async for chunk in response.content.iter_any():
                data += chunk
                if len(data) > _MAX_BYTES:
                    raise ActionFailedError(_TOO_LARGE(link=url, most=_MAX_BYTES))
    except asyncio.TimeoutError:
        raise ActionFailedError(_SLOW(link=url)) from None
    except (aiohttp.ClientError, OSError, ValueError) as error:
        raise ActionFailedError(_NOT_FETCHED(link=url, error=str(error))) from None
    if expected_hash:
        await asyncio.to_thread(_check_hash, url, data, expected_hash)
    return bytes(data)


def _check_hash(url: str, data: bytearray, expected: str) -> None:
    """Raise ActionFailedError if data do not have a hash, whose length tells the algorithm."""
    algorithm = next(name for name, size in _HASHES.items() if size == len(expected))
    found = hashlib.new(algorithm, data, usedforsecurity=False).hexdigest()
    if found != expected.lower():
        raise ActionFailedError(_HASH(link=url, kind=algorithm, found=found, given=expected))


def unpack(data: bytes) -> dict[str, bytes]:
    """Return the files in a ZIP file by their paths in the folder of the scene.

    The files may also be in one folder of the archive, with `scene.json` among them.

    Raises:
        ActionFailedError: the data are no usable ZIP file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = [each for each in archive.infolist() if not each.is_dir()]
            if not entries or len(entries) > _MAX_FILES:
                raise ActionFailedError(_FILES(count=len(entries), most=_MAX_FILES))
            if sum(each.file_size for each in entries) > _MAX_BYTES:
                raise ActionFailedError(_CONTENT(most=_MAX_BYTES))
            files = {_inner_path(each.filename): archive.read(each) for each in entries}
    except _ZIP_ERRORS as error:
        raise ActionFailedError(_NO_ZIP(error=str(error))) from None
    if len(files) < len(entries):
        raise ActionFailedError(_SAME_NAME())
    folder = next(iter(files)).split("/")[0] + "/"
    if f"{folder}scene.json" in files and all(name.startswith(folder) for name in files):
        return {name.removeprefix(folder): content for name, content in files.items()}
    return files


def _inner_path(name: str) -> str:
    """Return the path of a file in an archive, without parts that lead out of the folder."""
    parts = PurePosixPath(name).parts
    return "/".join(part for part in parts if part not in ("/", ".."))


_TIMEOUT = 10.0
"""Maximum time from the acceptance of a new map or position until the robot reports it, in
seconds."""
_MAP_ID = ParameterType("mapId", "STRING", "name of the map", valid=bool, must_be=NOT_EMPTY)
_MAP_VERSION = ParameterType("mapVersion", "STRING", "version of the map")


async def _switch_map(run: Run, name: str, version: str | None = None) -> None:
    """Let the robot use a map, unless it already uses this map.

    Args:
        version: version that the map must have; None for any version.

    Raises:
        ActionFailedError: there is no such map or several, or the robot drives along an order,
            refuses the map, or does not report it as the current one.
        LinkError: the robot could not be reached.
    """
    execution = run.execution
    await execution.maps.read()
    if any(each.is_used(execution.robot.info) for each in execution.maps.find(name, version)):
        return
    chosen = _find_one(execution, name, version)
    run.require_not_driving_order()
    await run.request(SwitchMap(scene_name=chosen.scene, map_name=chosen.name))
    await run.wait(lambda: chosen.is_used(execution.robot.info), _TIMEOUT, _NOT_USED(map=name))
    await execution.robot.read_pose()
    await execution.maps.wait_for_marks()  # the next order may need them


@vehicle_action(
    "enableMap",
    NOT_ON_EDGES,
    "use a map, instead of the one that is used now; the position stays the same",
    _MAP_ID,
    _MAP_VERSION,
    blocking=STANDSTILL,
    repeatable=True,
)
async def enable_map(run: Run) -> None:
    """Let the robot use a map."""
    await _switch_map(run, run.parameters["mapId"], run.parameters["mapVersion"])


_POSITION = (
    ParameterType("x", "FLOAT", "position in the map, in m"),
    ParameterType("y", "FLOAT", "position in the map, in m"),
    ParameterType("theta", "FLOAT", "heading, in rad"),
    _MAP_ID,
    ParameterType(
        "lastNodeId", "STRING", "node on which the vehicle stands; empty for none", optional=True
    ),
)


async def _init_position(run: Run) -> None:
    """Initialise the robot at a pose; change the map first if necessary."""
    execution, wanted = run.execution, run.parameters

    def is_initialised() -> bool:
        place = execution.robot.position
        return place is not None and place.initialised and place.map_id == wanted["mapId"]

    run.require_not_driving_order()
    await _switch_map(run, wanted["mapId"])
    await run.request(InitRobot(pose=Pose2D(x=wanted["x"], y=wanted["y"], theta=wanted["theta"])))
    await execution.robot.read_pose()
    await run.wait(is_initialised, _TIMEOUT, _NOT_FOUND())
    if "lastNodeId" in wanted:
        execution.order.set_last_node(wanted["lastNodeId"])


# the same action has another name in version 3
init_position, initialize_position = (
    vehicle_action(
        name,
        NOT_ON_EDGES,
        "set the map and the position of the vehicle",
        *_POSITION,
        blocking=STANDSTILL,
        version=version,
    )(_init_position)
    for name, version in (("initPosition", "2"), ("initializePosition", "3"))
)


@vehicle_action(
    "deleteMap",
    INSTANT,
    "delete a map that is not used now",
    _MAP_ID,
    _MAP_VERSION,
    repeatable=True,
)
async def delete_map(run: Run) -> None:
    """Delete a map on the robot."""
    maps = run.execution.maps
    await _read_list(run.execution)
    found = _find_one(run.execution, run.parameters["mapId"], run.parameters["mapVersion"])
    if found.is_used(run.execution.robot.info):
        raise ActionFailedError(_USED(map=found.name))
    is_last = len(maps.of_scene(found.scene)) == 1
    name = "" if is_last else found.name  # without a name, the whole scene is deleted
    await run.request(Delete(scene_name=found.scene, map_name=name))
    await maps.read()


@vehicle_action(
    "downloadMap",
    INSTANT,
    "fetch a map, and store it on the robot in a scene of its name",
    _MAP_ID,
    _MAP_VERSION,
    ParameterType(
        "mapDownloadLink",
        "STRING",
        "http or https URL of a ZIP file with the files of a scene",
        valid=_is_url,
        must_be=_URL(),
    ),
    ParameterType(
        "mapHash",
        "STRING",
        f"hash of the ZIP file in hexadecimal: {', '.join(_HASHES)}",
        optional=True,
        valid=lambda value: len(value) in _HASHES.values(),
        must_be=_HASH_OF(kinds=", ".join(_HASHES)),
    ),
    repeatable=True,
)
async def download_map(run: Run) -> None:
    """Fetch the files of a scene, and store them on the robot."""
    run.report(ActionStatus.INITIALIZING)
    async with run.execution.maps.downloading:
        await _download(run)


async def _download(run: Run) -> None:
    """Fetch a map and store it on the robot; delete it again if it is not the wanted one.

    Raises:
        ActionFailedError: the robot has the map already, the file cannot be used, or the robot
            refused it, or to list its maps.
        LinkError: the robot could not be reached.
    """
    maps, wanted = run.execution.maps, run.parameters
    name, version = wanted["mapId"], wanted["mapVersion"]
    await _read_list(run.execution)
    if maps.find(name) or maps.of_scene(name):
        is_same = bool(maps.find(name, version))
        kind = ErrorType.DUPLICATE_MAP if is_same else ErrorType.ACTION
        raise ActionFailedError(_EXISTS(map=name), kind)
    run.report(ActionStatus.RUNNING)
    data = await fetch(wanted["mapDownloadLink"], wanted.get("mapHash", ""))
    files = await asyncio.to_thread(unpack, data)  # takes too long for the event loop
    file_datas = [FileData(name=each, data=content) for each, content in files.items()]
    await run.request(Upload(scene_name=name, file_datas=file_datas, method=Upload.kFull))
    await _read_list(run.execution)
    stored = [each for each in maps.of_scene(name) if each.name == name]
    # the version is empty if the robot does not report it
    if not stored or stored[0].version not in (version, ""):
        await run.request(Delete(scene_name=name))
        await maps.read()
        what = _ITS_VERSION(version=stored[0].version) if stored else _NO_SUCH_MAP()
        raise ActionFailedError(_OTHER_FILE(what=what, version=version, map=name))


async def _read_list(execution: Execution) -> None:
    """Read the list of maps, where an old list could replace or delete the wrong maps.

    Raises:
        ActionFailedError: the robot did not send the list.
        LinkError: the robot could not be reached.
    """
    if not await execution.maps.read():
        raise ActionFailedError(_NO_LIST())


def _find_one(execution: Execution, name: str, version: str | None) -> StoredMap:
    """Return the map with a name, and with a version if it is not None.

    Raises:
        ActionFailedError: there is no such map, or several scenes have one.
    """
    found = execution.maps.find(name, version)
    if len(found) == 1:
        return found[0]
    what = _MAP(map=name) if version is None else _MAP_OF_VERSION(map=name, version=version)
    if not found:
        raise ActionFailedError(_MISSING(what=what))
    scenes = ", ".join(each.scene for each in found)
    raise ActionFailedError(_SEVERAL(what=what, scenes=scenes))
