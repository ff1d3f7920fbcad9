"""Survey a robot: send every query, and listen to every push. It commands nothing."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from google.protobuf.message import Message
from rich.progress import TimeRemainingColumn

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import QUERIES, TOPICS, minimum_timeouts
from woosh_robot_agent.link import ConnectionLostError, LinkConfig, LinkError, RequestTimeoutError
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.connection import Connection, Sending
from woosh_robot_agent.link.frames import Envelope
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.link.reconnect import open_link
from woosh_robot_agent.link.reports import LinkRecord
from woosh_robot_agent.link.tasks import cancel_and_wait, run_with_timeout
from woosh_robot_agent.link.transport import Transport, TransportClosedError
from woosh_robot_agent.pb.map import map_pack_pb2 as pack
from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.map.storage_edit_pb2 import Find, Storages
from woosh_robot_agent.pb.robot.robot_pack_pb2 import CountData, PlanNavPath
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, ScannerData, Scene
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.robot.readiness import is_located
from woosh_robot_agent.tools.doctor.checks import HttpAnswer, ask_over_http
from woosh_robot_agent.tools.doctor.learn import SURVEY_FILE
from woosh_robot_agent.tools.doctor.observations import Observations, SeenFrame
from woosh_robot_agent.tools.doctor.survey_report import REPORT_FILE, markdown, results
from woosh_robot_agent.tools.options import ToolError, stop_event
from woosh_robot_agent.tools.progress import progress_bar

_SILENT = logging.getLogger(f"{__name__}.link")
"""Logger of the link. It is off, because the report says what the link would warn of."""
_SILENT.disabled = True
_EMPTY_REQUESTS = tuple(
    name
    for name in dict.fromkeys(
        (
            *(query.request for query in QUERIES),
            *(topic.push for topic in TOPICS),
            full_name(Feedbacks),
            full_name(Storages),
        )
    )
    if name != full_name(pack.SceneDataEasy)
)
"""Types that are requested without content in each round; SceneDataEasy needs the name of a scene.
Pushed types can be requested, too: a request without content cannot change anything."""
_LARGE_ROUNDS = 3
"""Number of rounds in which queries with large answers are sent."""
_PAUSE = 0.1
"""Time between two queries, in seconds."""
_SCAN_POLLS = 60
"""Number of scans that are requested in each round."""
_SCAN_POLL_PERIOD = 0.04
"""Time between two requests for a scan, in seconds: a fraction of the time between two scans."""
_MAX_UNANSWERED = 2
"""Number of unanswered queries of a type after which that type is not sent again."""
_MAX_SILENCE = 600.0
"""Time of silence after which the link itself gives up, in seconds: longer than any query takes."""
_RETRY = 1.0
"""Time until a lost connection is opened again, in seconds."""
_NEEDED_SPACE = 1 << 20
"""Space for the results that must be free before a survey begins, in bytes."""


class _ObservedCodec(JsonCodec):
    """The JSON of a client; adds each frame that is sent or received to the observations."""

    def __init__(self, seen: Observations) -> None:
        super().__init__()
        self._seen = seen
        self._loop = asyncio.get_running_loop()
        self._clock_offset = time.time() - time.monotonic()
        """Unix time at zero of the monotonic clock, in seconds."""

    def encode(self, type_name: str, body: Message | None, **fields: Any) -> str:
        data = super().encode(type_name, body, **fields)
        self._add(data, by_robot=False)
        return data

    def decode(self, data: str | bytes) -> Envelope:
        # the transport may pass on text as UTF-8, but `Observations` takes bytes for protobuf
        text = data if isinstance(data, str) else data.decode(errors="replace")
        self._add(text, by_robot=True)
        return super().decode(data)

    def _add(self, text: str, *, by_robot: bool) -> None:
        t = self._clock_offset + time.monotonic()  # by a clock that is never set
        # one connection number for all, so that the pushes after a reconnect count, too
        frame = SeenFrame(t, 1, by_robot, text)
        # in the event loop, because the link decodes large frames in another thread
        self._loop.call_soon_threadsafe(self._seen.add, frame)


class _Surveyor:
    """Queries a robot, and observes what it sends.

    Attributes:
        seen: what was observed so far.
        http: answers over HTTP, by query; None for a query that was not answered.
        lost: number of connections that were lost.
    """

    def __init__(self, config: LinkConfig) -> None:
        self.seen = Observations()
        self.http: dict[str, HttpAnswer | None] = {}
        self.lost = 0
        # a robot may be silent while it prepares a large answer; `_ask` notices if it hangs
        self._config = replace(config, liveness_timeout=_MAX_SILENCE)
        self._transport: Transport
        """The open connection; set by `run`, as is the next one."""
        self._connection: Connection
        self._make = RequestMaker(config.robot_id)
        self._rounds = 0
        """Number of completed rounds of requests."""
        self._unanswered: Counter[str] = Counter()
        """Number of requests since the last answer, by type."""

    async def run(self) -> None:
        """Observe the robot until the task is cancelled; reconnect when the connection is lost."""
        codec, record = _ObservedCodec(self.seen), LinkRecord(_SILENT)
        while True:
            try:
                self._transport = await open_link(self._config)
            except LinkError:
                pass
            else:
                # pushes need no consumer: the codec has added them to the observations
                self._connection = Connection(
                    self._transport, codec, self._config, record, lambda *_: None
                )
                try:
                    await self._ask_all()
                except LinkError:
                    self.lost += 1
                finally:
                    await self._connection.close(ConnectionLostError("the survey has closed it"))
            await asyncio.sleep(_RETRY)

    async def _ask_all(self) -> None:
        """Subscribe to everything, then send the queries in rounds until cancelled.

        Raises:
            LinkError: the connection is lost.
        """
        # also to types that robots are only known to send as answers
        self._connection.subscribe(list(_EMPTY_REQUESTS), on=True)
        while True:
            for request, timeout in self._requests():
                if self._unanswered[full_name(request)] < _MAX_UNANSWERED:
                    await self._ask(request, timeout)
                    await asyncio.sleep(_PAUSE)
            self._rounds += 1
            if self._rounds == 1:
                await self._ask_over_http()
            if self.seen.scans:  # to learn the time between two scans
                delays = [number * _SCAN_POLL_PERIOD for number in range(_SCAN_POLLS)]
                await asyncio.gather(*map(self._poll_scan, delays))
            await asyncio.sleep(_PAUSE)

    def _requests(self) -> Iterator[tuple[Message, float]]:
        """Yield the queries of a round, each with its timeout."""
        timeout, slow = self._config.request_timeout, minimum_timeouts()
        for name in _EMPTY_REQUESTS:
            yield self._make.empty(message_type(name)), max(timeout, slow.get(name, 0.0))
        mark = self._mark()
        yield self._make.address(Find(no=mark.identity.no)), timeout
        if self._rounds < _LARGE_ROUNDS:
            scene = (self.seen.latest(Scene)[0] or Scene()).scene_name
            large: list[Message] = [
                CountData(req_type=CountData.kGet),
                pack.SceneDataEasy(name=scene),
                pack.SceneData(name=scene),
                pack.SceneMd5(scene_name=scene),
                pack.SceneSync(),
                pack.Download(scene_name=scene),
            ]
            info, _ = self.seen.latest(RobotInfo)
            if info and is_located(info) and mark.HasField("pose"):
                # where a robot stands at the mark, or else the pose of the mark itself
                end = mark.pose.dock if mark.pose.HasField("dock") else mark.pose.real
                large.append(PlanNavPath(start=info.pose_speed.pose, end=end))
            for each in large:
                yield self._make.address(each), max(timeout, slow.get(full_name(each), 0.0))

    def _mark(self) -> mark_pb2.Storages.Base:
        """Return one of the robot's marks; an empty one if none is known."""
        storages, _ = self.seen.latest(mark_pb2.Storages)
        lists = storages.ListFields() if storages else []  # one for each type of mark
        return next((mark for _, found in lists for mark in found), mark_pb2.Storages.Base())

    async def _ask(self, request: Message, timeout: float) -> None:
        """Send a request, and wait for its answer; without one, ping the robot.

        Raises:
            LinkError: the connection is lost, or the robot answers neither the request nor the
                ping.
        """
        name = full_name(request)
        try:
            await self._connection.request(request, Sending(timeout))
        except RequestTimeoutError:
            self._unanswered[name] += 1
            await self._ping()
        except ConnectionLostError:  # perhaps because this type makes the robot end the link
            self._unanswered[name] += 1
            raise
        else:
            self._unanswered[name] = 0

    async def _ping(self) -> None:
        try:
            await run_with_timeout(self._config.request_timeout, self._transport.ping())
        except (TimeoutError, TransportClosedError):
            raise ConnectionLostError("a ping is not answered") from None

    async def _poll_scan(self, delay: float) -> None:
        """Request a scan after a delay, in seconds, even if earlier requests wait for answers."""
        await asyncio.sleep(delay)
        with suppress(RequestTimeoutError):
            await self._connection.request(self._make.empty(ScannerData), Sending())

    async def _ask_over_http(self) -> None:
        """Send each query over HTTP; stop after two if neither of them is answered."""
        for request, timeout in self._requests():
            answer = await ask_over_http(self._config, request, timeout)
            if answer and answer.envelope:
                answer.envelope.body = None  # not needed, and maybe large
            self.http[full_name(request)] = answer
            if len(self.http) > 1 and not any(self.http.values()):
                return
            await asyncio.sleep(_PAUSE)


def check_folder(folder: Path) -> None:
    """Check that a folder is empty, or does not exist.

    Raises:
        ToolError: it is not empty, not a folder, or cannot be read.
    """
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ToolError(f"{folder} is not empty: give --survey a new folder")
    except OSError as error:
        raise ToolError(f"{folder}: {error.strerror}") from None


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Raise ToolError if the block cannot write to a folder."""
    try:
        yield
    except OSError as error:
        raise ToolError(f"cannot write {folder}: {error.strerror}") from None


async def survey(config: LinkConfig, folder: Path, *, minutes: float, with_names: bool) -> str:
    """Make a survey, until its time is over or a signal arrives, and write its results.

    Args:
        folder: folder for the results; must be empty or not exist yet.
        with_names: True to keep what could identify the robot or its site.

    Returns:
        A summary for the user.

    Raises:
        ToolError: the robot has sent nothing, or the folder cannot be written.
    """
    with _writing(folder):  # before the survey, which would be lost otherwise
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder) as file:
            file.write(bytes(_NEEDED_SPACE))
    stop = stop_event()
    surveyor = _Surveyor(config)
    seen = surveyor.seen
    began = time.monotonic()
    running = asyncio.ensure_future(surveyor.run())
    stopping = asyncio.ensure_future(stop.wait())

    def progress() -> dict[str, Any]:
        text = f"answers {len(seen.answers)}, pushes {len(seen.pushes)}"
        return {"completed": time.monotonic() - began, "description": text}

    with progress_bar("survey", minutes * 60.0, progress, TimeRemainingColumn()):
        ends: set[asyncio.Future[Any]] = {running, stopping}
        await asyncio.wait(ends, timeout=minutes * 60.0, return_when=asyncio.FIRST_COMPLETED)
    seconds = time.monotonic() - began
    complete = not stop.is_set()
    if running.done():
        running.result()  # raise its exception
    await cancel_and_wait(running, stopping)
    if not seen.frames:
        raise ToolError("the robot has sent nothing, so nothing is written: see the checks")
    found = results(
        seen,
        http=surveyor.http,
        seconds=seconds,
        complete=complete,
        lost=surveyor.lost,
        address=config.address,
        with_names=with_names,
    )
    with _writing(folder):
        text = json.dumps(found, indent=1, ensure_ascii=False)
        for name, content in ((SURVEY_FILE, f"{text}\n"), (REPORT_FILE, markdown(found))):
            # a robot may send half a surrogate pair: it has no UTF-8, but an escape that JSON reads
            (folder / name).write_text(content, encoding="utf-8", errors="backslashreplace")
    early = "" if complete else ", stopped early"
    return (
        f"surveyed for {seconds:.0f} s{early}: {len(seen.answers)} answers, "
        f"{len(seen.pushes)} pushes; read {folder / REPORT_FILE}"
    )
