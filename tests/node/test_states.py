"""battery_state, plan, footprint, connected, map and /diagnostics, with the simulated robot."""

from __future__ import annotations

import io
import math
import zlib
from dataclasses import replace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PolygonStamped
from nav_msgs.msg import OccupancyGrid, Path
from PIL import Image
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState

from tests.harness import wait_until
from tests.node.goals import short_task
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    HardwareState,
    NavPath,
    RobotInfo,
    RobotState,
    Scene,
    TaskProc,
)
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.navigation_pb2 import Path as PbPath
from woosh_robot_agent.robot.maps import MapError, cells_of
from woosh_robot_agent.simulator import Outgoing
from woosh_robot_msgs.srv import RobotState as RobotStateSrv

pytestmark = pytest.mark.usefixtures("frequent")

SCENE_DATA = "woosh.map.SceneData"
OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


def test_battery_state_plan_and_footprint(simulator, agent, client):
    states = client.echo(BatteryState, "battery_state")
    first = states.wait_count(1)[0]
    assert first.percentage == pytest.approx(0.93)
    assert first.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    assert first.present
    assert math.isnan(first.voltage)
    simulator.push(Battery(power=40, charge_state=Battery.kAuto))
    charging = BatteryState.POWER_SUPPLY_STATUS_CHARGING
    last = states.wait(lambda m: m.power_supply_status == charging)
    assert last.percentage == pytest.approx(0.4)

    plans = client.echo(Path, "plan")
    assert not plans.wait_count(1)[0].poses, "the first one is empty"
    goal = short_task(client, 1.0)
    plan = plans.wait(lambda m: len(m.poses) > 1)
    end = plan.poses[-1]
    assert (plan.header.frame_id, end.header.frame_id) == ("map", "map")
    assert goal.result()[0]
    pose = simulator.state.pose
    at = end.pose.position
    assert (at.x, at.y) == pytest.approx((pose.x, pose.y), abs=0.02)
    wait_until(lambda: not plans.messages[-1].poses, "the end of the path")

    footprints = client.echo(PolygonStamped, "footprint")
    first = footprints.wait_count(1)[0]
    assert first.header.frame_id == "base_link"
    assert len(first.polygon.points) == 8
    assert client.command("robot/SwitchFootPrint", type=2).ok
    last = footprints.wait(lambda m: m.polygon != first.polygon)
    # repeated with new stamps: viewers draw it at the robot's pose at that time
    footprints.wait(lambda m: m.polygon == last.polygon and m.header.stamp != last.header.stamp)


def test_the_first_plan_does_not_replace_a_newer_one(simulator, connect, client):
    """The chassis pushes a new path right after its answer, in a burst of frames."""
    old, new = (NavPath(path=PbPath(poses=[Pose2D()] * count)) for count in (2, 3))

    def answer(out: Outgoing) -> list[Outgoing]:
        if out.request != "woosh.robot.NavPath":
            return [out]
        before = [Outgoing("woosh.robot.RobotState", RobotState(state=2))] * 3
        return [*before, replace(out, body=old), Outgoing(out.type, new)]

    simulator.intercept(answer)
    agent = connect()
    for links in range(1, 4):
        agent.wait_connected(links)
        simulator.wait_received("woosh.robot.NavPath", links)
        client.call(RobotStateSrv, "robot/RobotState")  # until then, both have been handled
        assert len(client.echo(Path, "plan").wait_count(1)[0].poses) == 3
        simulator.drop()


class TestMap:
    @pytest.fixture
    def scene(self, simulator) -> SceneData:
        """The chassis's answer to a request for its maps; a test may change it."""
        data = SceneData(name="wooshmap")
        data.maps.add(
            id=0,
            name="wooshmap",
            resolution=0.5,
            origin=Pose2D(x=-1.0, y=-2.0),
            map_png=png([[255, 205, 0], [0, 255, 255]]),
        )

        def answer(frame: Outgoing) -> list[Outgoing]:
            if frame.request != SCENE_DATA:
                return [frame]
            return [Outgoing(SCENE_DATA, data, frame.sn, True, "", frame.request)]

        simulator.intercept(answer)
        return data

    def test_it_is_requested_on_demand_and_again_when_it_changes(
        self, simulator, scene, agent, client
    ):
        diagnostics(client).wait_count(5)  # meanwhile, a request would have been due
        assert simulator.counts[SCENE_DATA] == 0
        grids = client.echo(OccupancyGrid, "map")
        grid = grids.wait_count(1)[0]
        assert grid.header.frame_id == "map"
        assert (grid.info.width, grid.info.height) == (3, 2)
        assert grid.info.resolution == pytest.approx(0.5)
        assert (grid.info.origin.position.x, grid.info.origin.position.y) == (-1.0, -2.0)
        # the last row of the image is the first of the grid
        assert list(grid.data) == [100, 0, 0, 0, -1, 100]
        scene.name = scene.maps[0].name = "scenex"
        scene.maps[0].map_png = png([[0]])
        assert client.command("robot/SwitchMap", scene_name="scenex").ok
        assert list(grids.wait(lambda m: m.info.width == 1).data) == [100]

    def test_a_map_that_is_replaced_while_it_is_requested_is_not_shown(
        self, simulator, scene, agent, client
    ):
        old = SceneData()
        old.CopyFrom(scene)
        scene.maps[0].map_png = png([[0]])
        first = iter([Scene(scene_name="wooshmap", map_name="wooshmap", version=99)])

        def answer(frame: Outgoing) -> list[Outgoing]:
            change = next(first, None) if frame.request == SCENE_DATA else None
            if change is None:
                return [frame]
            return [Outgoing("woosh.robot.Scene", change), replace(frame, body=old)]

        simulator.intercept(answer)
        grids = client.echo(OccupancyGrid, "map")
        grids.wait(lambda m: m.info.width == 1)
        assert [grid.info.width for grid in grids.messages] == [1]

    def test_bad_images_are_refused(self):
        with pytest.raises(MapError):
            cells_of(b"")
        with pytest.raises(MapError):
            cells_of(png([[1, 2, 3]] * 3)[:40])
        good, gamma = png([[0]]), b"\0\0\0\0gAMA" + zlib.crc32(b"gAMA").to_bytes(4, "big")
        with pytest.raises(MapError):  # Pillow raises a ValueError for this chunk without content
            cells_of(good[:33] + gamma + good[33:])
        with pytest.raises(MapError):
            cells_of(png([[0]], "GIF"))
        assert cells_of(png([[0]])) == (1, 1, cells_of(png([[0]]))[2])

    @pytest.mark.parametrize("image_format", ["PNG", "PPM"])
    def test_an_image_with_16_bits_gives_the_same_cells(self, image_format):
        greys = [0, 60, 205, 254]
        deep = png([[grey * 257 for grey in greys]], image_format, "I;16")
        assert cells_of(deep) == cells_of(png([greys]))


def png(rows: list[list[int]], image_format: str = "PNG", mode: str = "L") -> bytes:
    image = Image.new(mode, (len(rows[0]), len(rows)))
    image.putdata([grey for row in rows for grey in row])
    file = io.BytesIO()
    image.save(file, image_format)
    return file.getvalue()


def diagnostics(client: Any) -> Any:
    return client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))


def of(array: Any, name: str) -> Any:
    (status,) = [s for s in array.status if s.name == f"woosh_robot/agent: {name}"]
    return status


def values(status: Any) -> dict[str, str]:
    return {each.key: each.value for each in status.values}


class TestDiagnostics:
    def test_a_ready_robot_what_keeps_it_from_tasks_and_faulty_devices(
        self, simulator, agent, client
    ):
        arrays = diagnostics(client)
        array = arrays.wait_count(1)[0]
        names = ["link", "chassis", "battery", "hardware", "abnormal codes", "motion", "clock"]
        names.append("agents")
        assert [s.name.rpartition(": ")[2] for s in array.status] == names
        # simulated time is faster than real time, so the clocks differ
        assert {bytes(s.level) for s in array.status if "clock" not in s.name} == {OK}
        assert {s.hardware_id for s in array.status} == {"30001"}
        link = values(of(array, "link"))
        assert link["state"] == "ready"
        assert link["reconnects"] == "0"
        assert int(link["rx"]) > 0
        assert values(of(array, "chassis"))["taskable"] == "yes"
        assert values(of(array, "battery"))["percent"] == "93"

        simulator.push(TaskProc(robot_task_id=7, type=task.kPick, state=task.kExecuting))
        array = arrays.wait(lambda a: values(of(a, "chassis"))["taskable"] == "no")
        assert of(array, "chassis").level == OK  # it is what the robot is for
        simulator.push(
            HardwareState(
                motor=[HardwareState.kNormal, HardwareState.kFatal], imu=HardwareState.kWarn
            )
        )
        status = of(arrays.wait(lambda a: of(a, "hardware").level == ERROR), "hardware")
        assert values(status) == {"motor 2": "fatal", "imu": "warn"}
        # each reason to reject a task is listed
        simulator.set_emergency_stop(True)
        assert client.command("robot/SwitchControlMode", mode=2).ok
        status = of(arrays.wait(lambda a: "manual" in of(a, "chassis").message), "chassis")
        assert status.level >= WARN
        assert "emergency stop is pressed" in status.message
        codes = of(arrays.wait(lambda a: of(a, "abnormal codes").level == ERROR), "abnormal codes")
        assert codes.message

    def test_a_low_battery_and_a_lost_link_are_errors(self, simulator, agent, client):
        arrays = diagnostics(client)
        simulator.push(Battery(power=15, charge_state=Battery.kNot))
        arrays.wait(lambda a: of(a, "battery").level == WARN)
        simulator.push(Battery(power=4, charge_state=Battery.kNot))
        arrays.wait(lambda a: of(a, "battery").level == ERROR)
        simulator.push(Battery(power=4, charge_state=Battery.kAuto))
        arrays.wait(
            lambda a: of(a, "battery").level == OK and values(of(a, "battery"))["percent"] == "4"
        )
        simulator.stop_listening()
        array = arrays.wait(lambda a: of(a, "link").level == ERROR)
        assert of(array, "battery").level == STALE
        simulator.listen()
        back = arrays.wait(lambda a: values(of(a, "link"))["reconnects"] == "1")
        assert of(back, "link").level == OK

    def test_a_battery_that_is_not_reported_is_not_empty(self, simulator, connect, client):
        def without_battery(frame: Outgoing) -> list[Outgoing]:
            if isinstance(frame.body, RobotInfo):
                frame.body.ClearField("battery")
            return [frame]

        simulator.intercept(without_battery)
        connect()
        array = diagnostics(client).wait(lambda a: len(a.status) > 2)
        assert of(array, "battery").level == STALE
