"""One robot of the page: its link, its map, its history, and its parts for the viewers."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import minimum_timeouts
from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    LinkConfig,
    LinkError,
    LinkState,
    OtherRobotError,
)
from woosh_robot_agent.link.tasks import cancel_and_wait
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.motion.wheel_owner import ACTIONS, EXECUTING
from woosh_robot_agent.pb.robot.robot_pack_pb2 import PlanNavPath
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath, RobotState, ScannerData
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.robot.readiness import LOST, NOT_INITIALISED, is_charging, objections
from woosh_robot_agent.sentences import Said, Sentence, said_by
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.commands import Args, CommandError, set_pose
from woosh_robot_agent.tools.dashboard.map_source import MapSource
from woosh_robot_agent.tools.dashboard.parts import SCAN, Parts
from woosh_robot_agent.tools.dashboard.texts import page_text, value_data
from woosh_robot_agent.tools.options import link_arguments
from woosh_robot_agent.tools.robot_view import (
    MAX_BACKOFF,
    RobotView,
    subscribe_all,
)

_LOG = logging.getLogger(__name__)
M = TypeVar("M", bound=Message)

_SAMPLE_PERIOD = 2.0
"""Time between two samples of the history, in seconds."""
_HISTORY = 1800
"""Time for which samples are kept, in seconds."""
_GAP = 10
"""Time between two samples beyond which the plots have a gap, in seconds."""
_UPDATE_PERIOD = 0.1
"""Minimum time between two updates of the viewers, in seconds."""
_MAP_PERIOD = 1.0
"""Time between two checks whether the robot uses another map, in seconds."""
_LISTEN_PERIOD = 0.1
"""Time between two checks whether the robot has sent a frame, in seconds."""
_PROBE_AFTER = 0.5
"""Silence after which a small value is requested from the robot, in seconds.

A standing robot pushes nothing, and scans may be rare.
"""
_BUSY = 0.3
"""Delay of a check beyond which this program was busy, in seconds.

Such a delay does not count as silence of the robot.
"""
_NO_PATH = Sentence("the robot answered with {type}, not with a path")
_REFUSED_PATH = Sentence("{reason} (the robot: {text})")
_UNREACHABLE = Sentence("the place may be in or near a wall, outside of the map, or cut off")
READ_ONLY = page_text("reason.readOnly")
"""Reason for which each command is refused if the dashboard runs without control."""


class Robot:
    """A robot that viewers watch: its link, and the parts about it. Used in one event loop.

    A part is a named section of the page's data, and a viewer is an open page; see `Parts`. Scans
    are requested while a viewer watches this robot, the map while a viewer watches any robot.

    Args:
        shared: the parts that are not about a single robot; every viewer watches them.
        control: True if the robot may be commanded. Otherwise the client of the link refuses every
            request that could change or move something.
        scan_rate: rate at which scans are requested, in Hz.

    Attributes:
        view: state of the robot as received so far.
        requests: creates requests, with the robot's id if an id is configured.
        parts: the parts about this robot, which its viewers watch.
        lost_actions: names of the actions that were executing when the link was lost, and whose
            state is unknown since then.
        samples: what `_sample` has returned in the last half hour, oldest first.
        silence: time for which the robot has been connected but has sent nothing, in whole seconds;
            0 while no viewer watches any robot.
        order: returns the order that a fleet manager has given the robot; None without one. The
            program that runs the dashboard may replace it.
    """

    def __init__(
        self, config: LinkConfig, shared: Parts, *, control: bool, scan_rate: float
    ) -> None:
        self.chassis = ChassisClient(
            config=replace(config, backoff_max=MAX_BACKOFF), minimum_timeouts=minimum_timeouts()
        )
        if not control:
            self.chassis.permit_only(only_reads, READ_ONLY)
        self.view = RobotView()
        self.requests = RequestMaker(config.robot_id)
        self.parts = Parts()
        self.map = MapSource(self.chassis, self.view, self.parts.changed)
        self.lost_actions: set[str] = set()
        self.silence = 0
        self.order: Callable[[], dict[str, Any] | None] = lambda: None
        self._shared = shared
        self._scan_rate = scan_rate
        self._failed = False
        """True if an unexpected error has ended the updates of the parts."""
        self.samples: list[list[Any]] = []
        self._code_times: dict[tuple[int, ...], int] = {}
        """Unix times of the view's status codes by this computer's clock, in ms, by their keys."""
        self._fastest = 0.0
        """Greatest speed since the last sample, in m/s."""
        self._path_link_and_map: tuple[Any, ...] = ()
        """Value of `_link_and_map` when the last path was received; empty before."""
        for name, source in (
            ("pose", lambda: part_data.pose_data(self.view.info)),
            ("robot", lambda: part_data.robot_data(self.view, self.lost_actions)),
            ("outline", lambda: part_data.outline_data(self.view.info)),
            ("path", lambda: part_data.path_data(self.view) if self._is_path_valid else []),
            ("codes", lambda: part_data.codes_data(self.view, self._code_times)),
            ("map", self.map.data),
            ("scenes", self.map.scenes_data),
        ):
            self.parts.add(name, source)
        for name, periodic in (
            ("link", self._link_data),
            ("details", lambda: part_data.details_data(self.view, self.chassis)),
            ("sample", lambda: self.samples[-1] if self.samples else None),
        ):
            self.parts.add(name, periodic, on_change=False, each_second=True)
        self._running: asyncio.Task[None] | None = None
        self._asking_actions: asyncio.Task[None] | None = None
        """Task of `_ask_actions`; kept, because the event loop has only a weak reference."""
        self.chassis.on_state(self._link_changed)
        subscribe_all(self.chassis, self._received)

    def start(self) -> None:
        """Start connecting."""
        self.chassis.start()
        self._running = asyncio.get_running_loop().create_task(self._run(), name="dashboard")

    async def close(self) -> None:
        """Close the link."""
        self.map.close()
        if self._running is not None:
            self._running.cancel()
            await asyncio.wait({self._running})
        await self.chassis.close()

    def show_failure(self) -> None:
        """Show that the parts are no longer updated, because of an unexpected error."""
        self.silence, self._failed = 0, True
        self.parts.publish("link")

    @property
    def executing(self) -> set[str]:
        """Names of the actions that the robot executes, as it has reported."""
        return {
            name
            for name, each in self.view.actions.items()
            if each.action in ACTIONS and each.state in EXECUTING
        }

    @property
    def no_data(self) -> Said | None:
        """Reason why what is known of the robot is out of date; None if it is up to date."""
        if self._failed:
            return page_text("link.failed")
        return page_text("reason.noData", seconds=self.silence) if self.silence else None

    @property
    def is_live(self) -> bool:
        """True if there is a link, and what is known of the robot is up to date."""
        return self.chassis.state is LinkState.READY and self.no_data is None

    @property
    def link_state(self) -> str:
        """State of the link: `connected`, `lost`, or `not connected` if it never was.

        After an unexpected error it is `failed`, because the parts are no longer updated.
        """
        if self._failed:
            return "failed"
        if self.chassis.state is LinkState.READY:
            return "connected"
        return "lost" if self.chassis.stats.connects else "not connected"

    @property
    def _link_and_map(self) -> tuple[Any, ...]:
        """Number of connections so far, scene, map and its version."""
        scene = self.view.info.scene
        connects = self.chassis.stats.connects
        return connects, scene.scene_name, scene.map_name, scene.version

    @property
    def _is_path_valid(self) -> bool:
        """True if the last path was received on this link, for the map that the robot uses now."""
        return self._path_link_and_map == self._link_and_map

    async def plan(self, args: Args) -> dict[str, Any]:
        """Ask the robot how it would drive to a pose, without driving there.

        Returns:
            The points of the path and its length, in metres.

        Raises:
            CommandError: the arguments are no pose, or the robot does not answer with a path.
            LinkError: as in `ChassisClient.request`.
        """
        request = PlanNavPath()
        set_pose(request.end, args)
        request.start.CopyFrom(self.view.info.pose_speed.pose)
        answer = await self.chassis.request(self.requests.address(request))
        if not answer.ok:
            without_pose = (NOT_INITIALISED, LOST)
            found = (each.said for each in objections(self.view.info) if each in without_pose)
            reason = next(found, _UNREACHABLE())
            raise CommandError(_REFUSED_PATH(reason=reason, text=answer.reason))
        if not isinstance(answer.body, NavPath):
            raise CommandError(_NO_PATH(type=answer.type))
        points = part_data.points_data(answer.body.path.poses)
        length = sum(map(math.dist, points, points[1:]))
        return {"path": points, "length": round(length, 2)}

    def _link_changed(self, state: LinkState) -> None:
        self.parts.changed()
        if state is LinkState.READY:  # requests are possible
            self._asking_actions = asyncio.get_running_loop().create_task(self._ask_actions())

    async def _ask_actions(self) -> None:
        """Ask for the actions in progress: RobotInfo lacks them, and robots push only changes.

        If there is no usable answer, `lost_actions` does not change.
        """

        def take_answer(answer: Answer) -> None:
            if answer.ok and isinstance(answer.body, Feedbacks):
                self.lost_actions.clear()
                self._received(answer.body)

        with contextlib.suppress(LinkError):
            await self.chassis.request(self.requests.empty(Feedbacks), tap=take_answer)

    def _received(self, message: Message) -> None:
        executing = self.executing
        self.view.update(message)
        # the RobotInfo of a new link removes all actions from the view
        self.lost_actions = (self.lost_actions | executing) - self.view.actions.keys()
        if isinstance(message, NavPath):
            self._path_link_and_map = self._link_and_map
        self._note_code_times()
        self._note_speed()
        self.parts.changed()
        self._shared.changed()

    def _note_speed(self) -> None:
        speed = self.view.info.pose_speed.twist.linear
        if math.isfinite(speed):
            self._fastest = max(self._fastest, abs(speed))

    def _note_code_times(self) -> None:
        """Note the time of each new code, once: the robot's clock may jump later."""
        ahead = 1000.0 * (self.chassis.stats.clock_offset or 0.0)  # ms
        self._code_times = {
            key: self._code_times.get(key, int(code.time - ahead))
            for key, code in self.view.codes.items()
        }

    async def _run(self) -> None:
        loops = [
            asyncio.ensure_future(each)
            for each in (
                self.parts.publish_changes(_UPDATE_PERIOD),
                self.parts.publish_each_second(),
                self._update_map_and_path(),
                self._request_scans(),
                self._measure_silence(),
                self._record_samples(),
            )
        ]
        try:
            await asyncio.gather(*loops)
        except Exception:
            address = self.chassis.config.address
            _LOG.exception("the page no longer updates %s; restart the dashboard", address)
            self.show_failure()
        finally:
            await cancel_and_wait(*loops)

    async def _record_samples(self) -> None:
        """Sample the robot for the plots; a sample without values marks a gap in time."""
        while True:
            sample = self._sample()
            begin, end = sample[0] - _HISTORY, sample[0]
            # without samples from the future: the clock may have been set back
            samples = [each for each in self.samples if begin < each[0] < end]
            if samples and end - samples[-1][0] > _GAP:
                samples.append([end - 1, None, None, None, None])
            self.samples = [*samples, sample]
            await asyncio.sleep(_SAMPLE_PERIOD)

    def _sample(self) -> list[Any]:
        """Return Unix time in s, speed in m/s, battery in percent, delay in ms, and if it charges.

        All but the time may be None, for unknown. The speed is the greatest one since the last
        sample.
        """
        info, stats = self.view.info, self.chassis.stats
        moment = part_data.now() // 1000
        speed, self._fastest = round(self._fastest, 3), 0.0
        is_known = self.chassis.state is LinkState.READY and self.view.has_robot_info
        if not is_known or self.silence:
            return [moment, None, None, None, None]
        self._note_speed()  # a robot that drives steadily may report its speed rarely
        has_battery = info.HasField("battery")
        battery = info.battery.power if has_battery else None
        charging = is_charging(info.battery) if has_battery else None
        delay = None if stats.round_trip is None else round(stats.round_trip * 1000.0, 1)
        return [moment, speed, battery, delay, charging]

    async def _update_map_and_path(self) -> None:
        """Keep the map up to date, and request the path that the robot follows if it is unknown."""
        asking: asyncio.Task[None] | None = None
        while True:
            if not self._shared.watched.is_set():
                self.map.end_subscription()
            # also if no viewer watches this robot: its link may be lost when one chooses it
            await self._shared.watched.wait()
            self.map.update()
            # robots push the path only when it changes, which may have been before the connection
            lacks_path = part_data.may_navigate(self.view) and not self._is_path_valid
            if self.parts.watched.is_set() and lacks_path and (asking is None or asking.done()):
                asking = asyncio.create_task(self._ask(NavPath), name="path")
            await asyncio.sleep(_MAP_PERIOD)

    async def _request_scans(self) -> None:
        loop = asyncio.get_running_loop()
        due = -math.inf
        while True:
            await self.parts.watched.wait()
            due = max(due + 1.0 / self._scan_rate, loop.time())
            await asyncio.sleep(due - loop.time())
            scan = await self._request(ScannerData)
            if scan is not None:
                pose = self.view.info.pose_speed.pose
                frame = part_data.scan_frame(scan, (pose.x, pose.y, pose.theta))
                if frame is not None:
                    self.parts.put(SCAN, frame)

    async def _measure_silence(self) -> None:
        """Measure the silence of the robot, and update the viewers after each second of silence."""
        loop = asyncio.get_running_loop()
        received, heard_at = 0, loop.time()  # number of frames, and time of the last one
        asking: asyncio.Task[None] | None = None
        while True:
            if not self._shared.watched.is_set():
                self.silence = 0
                await self._shared.watched.wait()
                heard_at = loop.time()
            due = loop.time() + _LISTEN_PERIOD
            await asyncio.sleep(_LISTEN_PERIOD)
            now = loop.time()
            if now - due > _BUSY:
                heard_at += now - due
            if self.chassis.state is not LinkState.READY or self.chassis.stats.rx != received:
                heard_at = now
            received = self.chassis.stats.rx
            silence = now - heard_at
            if silence > _PROBE_AFTER and (asking is None or asking.done()):
                asking = loop.create_task(self._ask(RobotState), name="dashboard probe")
            if int(silence) != self.silence:
                self.silence = int(silence)
                self.parts.publish("link")

    async def _ask(self, cls: type[Message]) -> None:
        """Request a value, and use the answer like a push."""
        value = await self._request(cls)
        if value is not None:
            self._received(value)

    async def _request(self, cls: type[M]) -> M | None:
        """Request a value; return None without a usable answer. The page shows a lost link."""
        if self.chassis.state is not LinkState.READY:
            return None
        try:
            answer = await self.chassis.request(self.requests.empty(cls))
        except LinkError:
            return None
        return answer.body if answer.ok and isinstance(answer.body, cls) else None

    def _link_data(self) -> dict[str, Any]:
        """Return the state of the link.

        `since` is the Unix time at which the link last became ready or was lost, in ms. `delay` is
        the round-trip time in ms, None if it is unknown. `silence` is in seconds. `good` is False
        while what the page shows of the robot may be out of date. `error` tells why there is no
        link, and `advice` has the options with which `doctor` examines it; both may be empty.
        """
        chassis = self.chassis
        ready, error = chassis.state is LinkState.READY, chassis.last_error
        round_trip = chassis.stats.round_trip
        # the text of an `OtherRobotError` has the remedy
        needs_advice = not ready and not isinstance(error, OtherRobotError)
        return {
            "good": self.is_live,
            "state": self.link_state,
            "since": int(chassis.since * 1000),
            "silence": self.silence if ready else 0,
            "error": "" if ready or error is None else value_data(said_by(error)),
            "advice": link_arguments(chassis.config) if needs_advice else "",
            "delay": None if round_trip is None else round(round_trip * 1000.0),
        }
