"""What the dashboard sends to a page: the state of the robot, live."""

from __future__ import annotations

import asyncio
import io
import itertools
import math
import ssl
import struct
import time
from typing import Any

import pytest
from PIL import Image

from tests.asynchronous import TIMEOUT, eventually
from tests.quick_chassis import quick_config
from tests.tools.dashboard.pages import (
    Delay,
    controlled,
    dashboard,
    delayed,
    fetch,
    last,
    page,
    say,
)
from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    BuildMap,
    BuildMapData,
    ExecTask,
    InitRobot,
    Twist,
)
from woosh_robot_agent.pb.robot.robot_pb2 import (
    NavPath,
    PoseSpeed,
    RobotInfo,
    RobotState,
    ScannerData,
    Scene,
)
from woosh_robot_agent.pb.util import robot_pb2
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard import map_source, server
from woosh_robot_agent.tools.dashboard.map_source import MapSource
from woosh_robot_agent.tools.dashboard.part_data import (
    lanes_data,
    points_data,
    pose_data,
    scan_frame,
    zones_data,
)
from woosh_robot_agent.tools.robot_view import RobotView


async def test_the_error_of_another_map_ends_with_its_use(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        await viewer.until(lambda parts: parts["map"]["marks"])
        chassis.refuse(full_name(SceneData), "the scene is damaged")
        await viewer.give("switchMap", scene="scenex", map="scenex2")
        await viewer.until(lambda parts: parts["map"]["error"])
        await viewer.give("switchMap", scene="wooshmap", map="wooshmap")
        await viewer.until(lambda parts: parts["map"]["marks"] and not parts["map"]["error"])
        assert viewer.parts["map"]["name"] == "wooshmap"


async def test_a_map_that_cannot_be_had_is_requested_after_ever_longer_pauses(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may cost the link each time, or take so long that other answers are late."""
    name, clock = full_name(SceneData), asyncio.get_running_loop().time
    chassis.refuse(name, "the scene is damaged")
    async with ChassisClient(config=LinkConfig("127.0.0.1", chassis.port)) as client:

        async def wait_requested(source: MapSource, version: int, count: int) -> None:
            def is_requested() -> bool:
                view.update(Scene(scene_name="hall", version=version))
                source.update()
                return chassis.counts[name] >= count

            await eventually(is_requested)

        monkeypatch.setattr(map_source, "_RETRY_DELAY", 3600.0)
        view = RobotView()
        source = MapSource(client, view, lambda: None)
        await wait_requested(source, 1, 1)
        await wait_requested(source, 2, 2)  # another map may be smaller
        monkeypatch.setattr(map_source, "_RETRY_DELAY", 0.05)
        source, begin = MapSource(client, view, lambda: None), clock()
        await wait_requested(source, 2, 8)
        assert clock() - begin > 0.8 * 0.05 * (1 + 2 + 4 + 8 + 16)


async def test_a_map_that_was_made_while_nobody_watched_is_shown(chassis: SimulatorThread) -> None:
    """It may have the name and version of the one before."""
    async with ChassisClient(
        config=LinkConfig("127.0.0.1", chassis.port, backoff_min=0.05)
    ) as client:
        view = RobotView()
        view.update(Scene(scene_name="wooshmap", map_name="wooshmap"))
        source = MapSource(client, view, lambda: None)

        async def wait_shown(number: int) -> None:
            def is_shown() -> bool:
                source.update()
                return source.number == number

            await eventually(is_shown)

        await wait_shown(1)
        chassis.push(RobotState(state=robot_pb2.kMapping))
        await wait_shown(2)
        chassis.drop()
        await wait_shown(3)


async def test_a_map_grows_while_it_is_made_and_ends_with_its_discard(
    chassis: SimulatorThread,
) -> None:
    pytest.importorskip("scipy", reason="the simulated chassis makes maps with it")
    async with dashboard(chassis, control=True) as running, page(running) as viewer:
        before = await viewer.until(lambda parts: parts["map"]["marks"] and parts["map"]["number"])
        await viewer.give("workMode", mode="deploy")
        await viewer.give("buildMap", type="add", scene="hall", map="ground")
        assert last(chassis, BuildMap).type == BuildMap.kAdd
        await viewer.until(lambda parts: parts["robot"]["state"] == "mapping")
        area = await viewer.until(
            lambda parts: (
                parts["map"]["number"] > before + 1 and "marks" not in parts["map"] and parts["map"]
            )
        )
        status, _, body = await fetch(running, f"/map/0/{area['number']}.png")
        assert status == 200
        with Image.open(io.BytesIO(body)) as image:
            assert image.format == "PNG"
        await viewer.send(do="visible", visible=False)
        ended = Subscription(topics=[full_name(BuildMapData)], sub=False)
        await eventually(lambda: chassis.last("woosh.Subscription") == ended)
        await viewer.send(do="visible", visible=True)
        await viewer.until(lambda parts: parts["map"]["number"] > area["number"])
        await viewer.give("discardMap")
        await viewer.until(lambda parts: parts["robot"]["state"] != "mapping")
        await viewer.until(lambda parts: parts["map"]["marks"])  # that of the scene again
        await viewer.give("collectMark")
        await viewer.give("keepPose")
        assert last(chassis, InitRobot).is_record


async def test_a_jump_of_the_robots_clock_moves_no_earlier_message(
    chassis: SimulatorThread,
) -> None:
    async with dashboard(chassis) as running, page(running) as viewer:
        await viewer.until(lambda parts: parts["robot"]["known"])
        chassis.set_emergency_stop(True)
        (before,) = await viewer.until(lambda parts: parts["codes"])
        chassis.inject("clock_jump", by=3600)
        chassis.set_emergency_stop(False)
        await viewer.until(lambda parts: not parts["robot"]["objections"])
        chassis.set_emergency_stop(True)
        newest, *_, oldest = await viewer.until(
            lambda parts: len(parts["codes"]) > 1 and parts["codes"]
        )
        assert oldest == before
        assert abs(newest["time"] / 1000 - time.time()) < TIMEOUT


async def test_scans_are_requested_only_while_somebody_watches(chassis: SimulatorThread) -> None:
    scanner = full_name(ScannerData)
    async with dashboard(chassis, scan_rate=50.0) as running:
        await eventually(lambda: running.robots[0].view.has_robot_info)
        assert chassis.counts[scanner] == 0
        async with page(running) as viewer:
            frame = await viewer.until(lambda parts: parts["scan"])
            assert len(frame) > 1000
            await viewer.send(do="visible", visible=False)
            robot = running.robots[0]
            await eventually(lambda: not robot.parts.watched.is_set())
            await eventually(lambda: chassis.counts[scanner] > 0)
            # the last one may be in flight; then there are no more, however long one waits
            count = await _settled(chassis, scanner)
            await viewer.send(do="visible", visible=True)
            await eventually(lambda: chassis.counts[scanner] > count + 2)


async def _settled(chassis: SimulatorThread, name: str) -> int:
    """Return the number of requests once two other requests have found the same number."""
    counts: list[int] = []
    config = LinkConfig("127.0.0.1", chassis.port)
    async with ChassisClient(config=config) as client:
        while len(counts) < 12 or counts[-1] != counts[-12]:
            await client.request(PoseSpeed())
            counts.append(chassis.counts[name])
    return counts[-1]


def test_a_scan_is_a_tenth_of_its_json() -> None:
    ranges = [1.0, 65.0, math.nan, math.inf, 0.01, 12.345]
    scan = ScannerData(
        angle_min=-1.0, angle_increment=0.5, range_min=0.05, range_max=30.0, ranges=ranges
    )
    scan.pose.x, scan.pose.y, scan.pose.theta = 1.0, 2.0, 0.5
    scan.offset.x = 0.25
    frame = scan_frame(scan, (0.0, 0.0, 0.0))
    assert frame is not None
    assert struct.unpack("<4x7f", frame[:32]) == (1.0, 2.0, 0.5, 0.25, 0.0, -1.0, 0.5)
    assert struct.unpack("<6H", frame[32:]) == (1000, 0, 0, 0, 0, 12345)
    scan.angle_increment = math.nan
    assert scan_frame(scan, (0.0, 0.0, 0.0)) is None


def test_a_speed_that_is_no_number_is_no_standstill() -> None:
    info = RobotInfo()
    info.pose_speed.pose.x = 1.0
    info.pose_speed.twist.linear = math.nan
    assert pose_data(info) is None


async def test_a_lost_robot_that_nobody_has_watched_is_shown_with_its_map(
    chassis: SimulatorThread, other: SimulatorThread
) -> None:
    chassis.stop_listening()
    async with dashboard(chassis, other) as running, page(running) as viewer:
        await eventually(lambda: running.robots[1].map.picture)
        other.stop_listening()
        await viewer.until(lambda parts: parts["fleet"][1]["link"] == "lost")
        await viewer.until(lambda parts: parts["fleet"][0]["link"] == "not connected")
        await viewer.send(do="watch", robot=1)
        await viewer.until(lambda parts: parts["robot"]["id"] == 8 and parts["map"]["marks"])


async def test_another_robot_at_the_address_is_refused(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        chassis.stop_listening()
        await viewer.until(lambda parts: not parts["link"]["good"])
        config = quick_config(port=chassis.port, tcp_port=0, robot_id=7)
        with SimulatorThread(config) as other:
            link = await viewer.until(
                lambda parts: "robot 7 " in say(parts["link"]["error"]) and parts["link"]
            )
            assert "answers instead of robot 30001" in say(link["error"])
            assert (link["good"], link["advice"]) == (False, "")
            assert viewer.parts["robot"]["id"] == 30001
            text = await viewer.refused("goMark", mark="A2")
            assert "answers instead of robot 30001" in text
            await viewer.until(lambda parts: parts["robot"]["id"] == 30001)
            assert other.counts[full_name(ExecTask)] == 0
        chassis.listen()
        await viewer.until(lambda parts: parts["link"]["good"])


async def test_a_robot_that_is_no_longer_updated_is_not_shown_as_live(
    chassis: SimulatorThread, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> None:
        raise RuntimeError("an odd value")

    async with dashboard(chassis, control=True) as running, page(running) as viewer:
        await viewer.ready()
        running.robots[0].parts.add("path", fail)
        link = await viewer.until(lambda parts: not parts["link"]["good"] and parts["link"])
        assert link["state"] == "failed"
        assert "an odd value" in caplog.text
        await viewer.until(lambda parts: parts["fleet"][0]["link"] == "failed")
        assert "dashboard has failed" in await viewer.refused("goMark", mark="A2")
        async with viewer.holds(0.3):
            await viewer.until(lambda _: "dashboard has failed" in viewer.refusals[-1])
        assert chassis.counts[full_name(ExecTask)] == chassis.counts[full_name(Twist)] == 0
        await viewer.give("stop")
    async with dashboard(chassis) as running, page(running) as viewer:
        await viewer.ready()  # it ends as usual


async def test_a_standing_robot_with_rare_scans_has_data(chassis: SimulatorThread) -> None:
    async with dashboard(chassis, scan_rate=0.1) as running, page(running) as viewer:
        await viewer.ready()
        robot, probe = running.robots[0], full_name(RobotState)
        before = chassis.counts[probe]

        def is_asked() -> bool:
            assert (robot.silence, viewer.parts["link"]["good"]) == (0, True)
            return chassis.counts[probe] > before + 3

        await eventually(is_asked)


async def test_silence_while_nobody_watches_does_not_count(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running, page(running) as viewer:
        robot = running.robots[0]
        await viewer.until(lambda parts: parts["link"]["good"])
        for cls in (RobotState, ScannerData):
            chassis.delay(full_name(cls), 0.3)
        await viewer.send(do="visible", visible=False)
        await eventually(lambda: not robot.parts.watched.is_set())
        await viewer.passed(1.5)
        seen, scans = set(), viewer.scans
        await viewer.send(do="visible", visible=True)

        def is_shown(parts: dict[str, Any]) -> bool:
            seen.add(robot.silence)
            return viewer.scans > scans + 3

        await viewer.until(is_shown)
        assert seen == {0}


async def test_a_page_with_a_slow_connection_gets_the_newest_state(
    chassis: SimulatorThread, certificate: list[str]
) -> None:
    """Over TLS, where the transport has a buffer of its own; below are plain connections."""
    server_tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    server_tls.load_cert_chain(certificate[1], certificate[3])
    client_tls = ssl.create_default_context(cafile=certificate[1])
    delay = Delay()
    async with (
        dashboard(chassis, tls=server_tls, scan_rate=10.0) as running,
        delayed(running, delay) as port,
        page(running, port, tls=client_tls) as viewer,
    ):
        await viewer.ready()
        delay.rate = 8e3  # a third of what it gets otherwise
        await asyncio.sleep(10.0)
        assert asyncio.get_running_loop().time() - viewer.parts["clock"] / 1000.0 < 6.0


async def test_a_large_part_that_changes_faster_than_it_is_sent_comes(
    chassis: SimulatorThread,
) -> None:
    delay = Delay()
    async with (
        dashboard(chassis, scan_rate=10.0) as running,
        delayed(running, delay) as port,
        page(running, port) as viewer,
    ):
        await viewer.ready()
        numbers = itertools.count()
        large = running.robots[0].parts
        large.add("large", lambda: [next(numbers), "x" * 120_000], each_second=True)
        delay.rate = 40e3
        for _ in range(3):
            await viewer.until(lambda parts: parts.pop("large", None))


async def test_a_long_history_does_not_delay_a_stop_over_a_slow_connection(
    chassis: SimulatorThread,
) -> None:
    delay = Delay()
    async with (
        dashboard(chassis, control=True) as running,
        delayed(running, delay) as port,
        page(running, port) as viewer,
    ):
        await viewer.ready()
        running.robots[0].samples = [
            [1_700_000_000 + n, 0.123, 93, 1.2, False] for n in range(3000)
        ]
        delay.rate = 16e3
        asking = asyncio.ensure_future(viewer.give("history"))
        await asyncio.sleep(0.5)
        await viewer.send(do="visible", visible=False)
        await viewer.send(do="visible", visible=True)
        clock = await viewer.until(lambda parts: parts["clock"])
        assert (await viewer.command_at(clock, "stop"))[0]
        assert not asking.done()
        await asking
        assert len(viewer.data[1]["samples"]) >= 3000


async def test_a_page_that_is_hidden_while_its_connection_is_full_still_gets_answers(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_CLOCK_PERIOD", TIMEOUT)
    async with dashboard(chassis, control=True) as running, page(running) as viewer:
        await viewer.ready()
        (served,) = running._viewers
        served._is_writable.clear()
        await eventually(lambda: served._stale)
        await viewer.send(do="visible", visible=False)
        await eventually(lambda: not served.visible)
        served._is_writable.set()
        assert (await viewer.command_at(0, "stop"))[0]


async def test_a_slow_viewer_delays_nobody_and_gets_the_newest_state(
    chassis: SimulatorThread,
) -> None:
    async with (
        dashboard(chassis, scan_rate=50.0) as running,
        page(running) as slow,
        page(running) as quick,
    ):
        await slow.until(lambda parts: parts["pose"])
        slow.socket.transport.pause_reading()
        begin = quick.scans
        pose = PoseSpeed()
        await quick.until(lambda _: quick.scans > begin + 20)
        pose.pose.x = 2.5
        chassis.push(pose)
        await quick.until(lambda parts: parts["pose"]["x"] == 2.5)
        slow.socket.transport.resume_reading()
        await slow.until(lambda parts: parts["pose"]["x"] == 2.5)


def test_a_path_with_fewer_points_keeps_its_ends() -> None:
    path = NavPath()
    for index in range(5000):
        path.path.poses.add(x=float(index))
    shown = points_data(path.path.poses)
    assert (shown[0], shown[-1]) == ([0.0, 0.0], [4999.0, 0.0])
    assert len(shown) <= 2000
    assert [points_data(path.path.poses[:n]) for n in (0, 1)] == [[], [[0.0, 0.0]]]


def test_the_points_of_all_zones_and_of_all_lanes_are_limited() -> None:
    area = SceneData.Map()
    for _ in range(600):
        lane = area.path_info.mono_paths.add()
        zone = area.field_info.crossings.add()
        for step in range(300):
            lane.path.add(x=step)
            zone.nav_filed.vertexs.add(x=step)
    lanes, zones = lanes_data(area), zones_data(area)
    assert (len(lanes), len(zones)) == (500, 500)
    assert 10_000 < sum(map(len, lanes)) <= 20_000
    assert 10_000 < sum(len(zone["outline"]) for zone in zones) <= 20_000
