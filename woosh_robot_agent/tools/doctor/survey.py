"""Survey a robot: send every query, and listen to every push. It commands nothing."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from google.protobuf.message import Message
from rich.progress import TimeRemainingColumn

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import QUERIES, TOPICS, minimum_timeouts
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.codecs import client_codec
from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPE, FrameError
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.link.tasks import cancel_and_wait, run_with_timeout
from woosh_robot_agent.link.transport import Transport, TransportClosedError, open_transport
from woosh_robot_agent.pb.map import map_pack_pb2 as pack
from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.map.storage_edit_pb2 import Find, Storages
from woosh_robot_agent.pb.robot.robot_pack_pb2 import CountData, PlanNavPath
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, ScannerData, Scene
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.robot.readiness import is_located
from woosh_robot_agent.tools.doctor.checks import HttpAnswer, ask_over_http
from woosh_robot_agent.tools.doctor.learn import SURVEY_FILE
from woosh_robot_agent.tools.doctor.observations import AnsweredRequest, Observations, SeenFrame
from woosh_robot_agent.tools.doctor.survey_report import REPORT_FILE, markdown, results
from woosh_robot_agent.tools.options import ToolError, stop_event
from woosh_robot_agent.tools.progress import progress_bar

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
_RETRY = 1.0
"""Time until a lost connection is opened again, in seconds."""
_NEEDED_SPACE = 1 << 20
"""Space for the results that must be free before a survey begins, in bytes."""
_CONNECTION_NUMBER = 1
"""Connection number in all frames. A reconnect keeps it, because it repeats no serial number."""


class _Survey:
    """A running survey.

    Attributes:
        http: answers over HTTP, by query; None for a query that was not answered.
        lost: number of connections that were lost.
    """

    def __init__(self, config: LinkConfig) -> None:
        self.seen = Observations()
        self.http: dict[str, HttpAnswer | None] = {}
        self.lost = 0
        self._config = config
        self._transport: Transport
        """The open connection; set by `run`."""
        self._clock_offset = time.time() - time.monotonic()
        """Unix time at zero of the monotonic clock, in seconds."""
        self._codec = client_codec(config)
        self._make = RequestMaker(config.robot_id)
        self._sn = 0
        self._waiting: dict[int, asyncio.Future[AnsweredRequest]] = {}
        """Requests in flight, by serial number."""
        self._rounds = 0
        """Number of completed rounds of requests."""
        self._unanswered: dict[str, int] = {}
        """Number of requests since the last answer, by type."""
        self._scene = ""
        """Name of the current scene, for requests of its data; empty until it is known."""
        self._mark = mark_pb2.Storages.Base()
        """One of the robot's marks, for the requests Find and PlanNavPath; empty without one."""
        self._pose: Pose2D | None = None
        """Pose of the robot; None if it is not known or not located."""

    async def run(self) -> None:
        """Observe the robot until the task is cancelled; reconnect when the connection is lost."""
        while True:
            try:
                self._transport = await open_transport(self._config)
            except (OSError, TransportClosedError):
                pass
            else:
                try:
                    await self._observe()
                except TransportClosedError:
                    self.lost += 1
                finally:
                    await self._transport.close(self._config.close_timeout)
            await asyncio.sleep(_RETRY)

    async def _observe(self) -> None:
        """Send queries and read frames until the connection is lost.

        Raises:
            TransportClosedError: the connection is lost.
        """
        reading = asyncio.ensure_future(self._read())
        asking = asyncio.ensure_future(self._ask_all())
        try:
            await asyncio.wait({reading, asking}, return_when=asyncio.FIRST_COMPLETED)
            for each in (reading, asking):
                if each.done():
                    each.result()  # raise its exception
        finally:
            self._waiting.clear()
            await cancel_and_wait(reading, asking)

    async def _read(self) -> None:
        """Add the frames of the robot, and hand each answer to the request that waits for it.

        Raises:
            TransportClosedError: the connection has ended.
        """
        while True:
            try:
                data = await self._transport.recv()
            except FrameError as error:
                self.seen.unreadable[f"a frame: {error.kind}"] += 1
                continue
            # the survey uses JSON, but `Observations` takes bytes for protobuf
            text = data if isinstance(data, str) else data.decode(errors="replace")
            answer = self.seen.add(SeenFrame(self._now(), _CONNECTION_NUMBER, True, text))
            waiting = self._waiting.pop(answer.sn, None) if answer else None
            if answer and waiting and not waiting.done():
                waiting.set_result(answer)

    async def _ask_all(self) -> None:
        """Subscribe to everything, then send the queries in rounds until cancelled.

        Raises:
            TransportClosedError: the connection is lost, or the robot does not answer a ping.
        """
        # also to types that robots are only known to send as answers
        subscription = Subscription(sub=True, topics=_EMPTY_REQUESTS)
        await self._send(SUBSCRIPTION_TYPE, subscription, 0)
        while True:
            for request, timeout in self._requests():
                if self._unanswered.get(full_name(request), 0) < _MAX_UNANSWERED:
                    await self._ask(request, timeout)
                    await asyncio.sleep(_PAUSE)
            self._rounds += 1
            if self._rounds == 1:
                await self._ask_over_http()
            # to learn the time between two scans, if the robot has shown that it makes any
            for _ in range(_SCAN_POLLS if self.seen.scans else 0):
                # without waiting for the answers, which may be late
                self._sn += 1
                await self._send(full_name(ScannerData), self._make.empty(ScannerData), self._sn)
                await asyncio.sleep(_SCAN_POLL_PERIOD)
            await asyncio.sleep(_PAUSE)

    def _requests(self) -> Iterator[tuple[Message, float]]:
        """Yield the queries of a round, each with its timeout."""
        timeout, slow = self._config.request_timeout, minimum_timeouts()
        for name in _EMPTY_REQUESTS:
            yield self._make.empty(message_type(name)), max(timeout, slow.get(name, 0.0))
        yield self._make.address(Find(no=self._mark.identity.no)), timeout
        if self._rounds < _LARGE_ROUNDS:
            scene = self._scene
            large: list[Message] = [
                CountData(req_type=CountData.kGet),
                pack.SceneDataEasy(name=scene),
                pack.SceneData(name=scene),
                pack.SceneMd5(scene_name=scene),
                pack.SceneSync(),
                pack.Download(scene_name=scene),
            ]
            if self._pose and self._mark.HasField("pose"):
                pose = self._mark.pose
                # where a robot stands at the mark, or else the pose of the mark itself
                end = pose.dock if pose.HasField("dock") else pose.real
                large.append(PlanNavPath(start=self._pose, end=end))
            for each in large:
                yield self._make.address(each), max(timeout, slow.get(full_name(each), 0.0))

    async def _ask(self, request: Message, timeout: float) -> None:
        """Send a request, wait for its answer, and keep what later requests need of it.

        Raises:
            TransportClosedError: the link is lost, or the robot answers neither this nor a ping.
        """
        self._sn += 1
        waiting: asyncio.Future[AnsweredRequest] = asyncio.get_running_loop().create_future()
        self._waiting[self._sn] = waiting
        name = full_name(request)
        # in advance, because perhaps this type makes the robot end the link
        self._unanswered[name] = self._unanswered.get(name, 0) + 1
        await self._send(name, request, self._sn)
        try:
            answer = await run_with_timeout(timeout, waiting)
        except TimeoutError:
            self._waiting.pop(self._sn, None)
            await self._check_link()
            return
        self._unanswered[name] = 0
        if isinstance(answer.body, RobotInfo):
            self._scene = answer.body.scene.scene_name
            located = is_located(answer.body)
            self._pose = answer.body.pose_speed.pose if located else None
        elif isinstance(answer.body, Scene):
            self._scene = answer.body.scene_name
        elif isinstance(answer.body, mark_pb2.Storages):
            lists = (found for _, found in answer.body.ListFields())  # one for each type of mark
            marks = (mark for found in lists for mark in found)
            self._mark = next(marks, mark_pb2.Storages.Base())

    async def _check_link(self) -> None:
        """Ping the robot.

        Raises:
            TransportClosedError: the robot does not answer.
        """
        try:
            await run_with_timeout(self._config.request_timeout, self._transport.ping())
        except TimeoutError:
            raise TransportClosedError("a ping is not answered") from None

    async def _send(self, name: str, body: Message, sn: int) -> None:
        now = self._now()
        data = self._codec.encode(name, body, sn=sn, timestamp=round(now * 1000))
        self.seen.add(SeenFrame(now, _CONNECTION_NUMBER, False, data))
        await self._transport.send(data)

    def _now(self) -> float:
        """Return the Unix time in seconds, by a clock that is never set."""
        return self._clock_offset + time.monotonic()

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
    running_survey = _Survey(config)
    began = time.monotonic()
    running = asyncio.ensure_future(running_survey.run())
    stopping = asyncio.ensure_future(stop.wait())

    def progress() -> dict[str, Any]:
        seen = running_survey.seen
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
    if not running_survey.seen.frames:
        raise ToolError("the robot has sent nothing, so nothing is written: see the checks")
    found = results(
        running_survey.seen,
        http=running_survey.http,
        seconds=seconds,
        complete=complete,
        lost=running_survey.lost,
        address=config.address,
        with_names=with_names,
    )
    with _writing(folder):
        text = json.dumps(found, indent=1, ensure_ascii=False)
        for name, content in ((SURVEY_FILE, f"{text}\n"), (REPORT_FILE, markdown(found))):
            # half a surrogate pair, as a robot may send it, is no UTF-8, but an escape in JSON
            (folder / name).write_text(content, encoding="utf-8", errors="backslashreplace")
    early = "" if complete else ", stopped early"
    return (
        f"surveyed for {seconds:.0f} s{early}: {len(running_survey.seen.answers)} answers, "
        f"{len(running_survey.seen.pushes)} pushes; read {folder / REPORT_FILE}"
    )
