"""Actions that download, enable and delete maps."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import http.client
import io
import threading
import time
import urllib.error
import urllib.request
import zipfile
import zlib
from collections.abc import Callable
from pathlib import PurePosixPath
from typing import TypeVar
from urllib.parse import urlsplit

from woosh_robot_agent.pb.map.map_pack_pb2 import Delete, Upload
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.util.common_pb2 import FileData
from woosh_robot_agent.vda5050.actions.performer import Context, PlainPerformer, Report
from woosh_robot_agent.vda5050.actions.robot_calls import ActionFailedError, Objection
from woosh_robot_agent.vda5050.messages.factsheet import (
    STANDSTILL,
    ActionType,
    ParameterType,
    Scope,
)
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType
from woosh_robot_agent.vda5050.robot.maps import StoredMap

T = TypeVar("T")


async def in_thread(work: Callable[[], T]) -> T:
    """Run a function in a thread of its own, and return its result.

    Unlike in the executor of the event loop, it keeps no other work waiting, and the program can
    end before it returns.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def finish(result: T | None, error: Exception | None) -> None:
        if done.cancelled():
            return
        if error is not None:
            done.set_exception(error)
        else:
            done.set_result(result)  # type: ignore[arg-type]

    def run() -> None:
        result, error = None, None
        try:
            result = work()
        except Exception as raised:
            error = raised
        with contextlib.suppress(RuntimeError):  # the event loop is closed
            loop.call_soon_threadsafe(finish, result, error)

    threading.Thread(target=run, name="vda5050 work", daemon=True).start()
    return await done


HASHES = {"sha256": 64, "sha1": 40, "md5": 32}
"""Supported hashes, and their lengths in hexadecimal digits."""
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
)
"""Errors of a ZIP file that is damaged, encrypted or compressed in an unknown way."""
_DOWNLOAD_TIMEOUT = 30.0
"""Maximum time without any data, in seconds."""
_MAX_DURATION = 600.0
"""Maximum duration of a download, in seconds."""
_CHUNK = 64 * 1024
"""Maximum number of bytes that are read at a time."""
_MAX_BYTES = 64 * 1024 * 1024
"""Maximum size of the ZIP file, and of all files in it together, in bytes."""
_MAX_FILES = 200
"""Maximum number of files in the ZIP file."""


class MapFileError(Exception):
    """The file of a map cannot be used. The text is the reason."""


def is_link(link: str) -> bool:
    """Return True if a text is a URL from which a file can be fetched."""
    try:
        parts = urlsplit(link)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and bool(parts.hostname)


def fetch(link: str, expected: str = "") -> bytes:
    """Fetch a file; this blocks.

    Args:
        link: http or https URL.
        expected: hash of the file in hexadecimal; empty for no check.

    Raises:
        MapFileError: it cannot be fetched, is too large or too slow, or has another hash.
    """
    opener = urllib.request.OpenerDirector()  # without the handlers for local files and FTP
    for handler in (
        urllib.request.ProxyHandler,
        urllib.request.HTTPHandler,
        urllib.request.HTTPSHandler,
        urllib.request.HTTPRedirectHandler,
        urllib.request.HTTPErrorProcessor,
        urllib.request.HTTPDefaultErrorHandler,
    ):
        opener.add_handler(handler())
    data = bytearray()
    deadline = time.monotonic() + _MAX_DURATION
    try:
        with opener.open(link, timeout=_DOWNLOAD_TIMEOUT) as response:
            while len(data) <= _MAX_BYTES and (chunk := response.read1(_CHUNK)):
                data += chunk
                if time.monotonic() > deadline:
                    raise MapFileError(f"the download of {link} takes too long")
    except (OSError, ValueError, http.client.HTTPException) as error:
        if isinstance(error, urllib.error.HTTPError):
            error.close()  # it holds the connection
        raise MapFileError(f"{link} cannot be fetched: {error}") from None
    if len(data) > _MAX_BYTES:
        raise MapFileError(f"{link} has more than {_MAX_BYTES} bytes")
    if expected:
        algorithm = next(name for name, size in HASHES.items() if size == len(expected))
        found = hashlib.new(algorithm, data, usedforsecurity=False).hexdigest()
        if found != expected.lower():
            raise MapFileError(f"{link} has the {algorithm} hash {found}, not {expected}")
    return bytes(data)


def unpack(data: bytes) -> dict[str, bytes]:
    """Return the files in a ZIP file by their names, without folders.

    Raises:
        MapFileError: it is no usable ZIP file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = [each for each in archive.infolist() if not each.is_dir()]
            if not entries or len(entries) > _MAX_FILES:
                raise MapFileError(f"the ZIP file has {len(entries)} files, not 1 to {_MAX_FILES}")
            if sum(each.file_size for each in entries) > _MAX_BYTES:
                raise MapFileError(f"the files in the ZIP file have more than {_MAX_BYTES} bytes")
            files = {PurePosixPath(each.filename).name: archive.read(each) for each in entries}
    except _ZIP_ERRORS as error:
        raise MapFileError(f"the downloaded file is no usable ZIP file: {error}") from None
    if len(files) < len(entries):
        raise MapFileError("two files in different folders of the ZIP file have the same name")
    return files


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
