"""While the robot makes a map, the topic map is that map."""

from __future__ import annotations

import math
import time
from contextlib import closing
from typing import Any

import pytest
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage

from tests.harness import Client, Collector, RunningAgent, wait_until
from tests.node.test_odom import chain
from tests.node.test_states import diagnostics, png
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotState, Scene
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util.common_pb2 import Pose2D, Twist
from woosh_robot_agent.simulator import Outgoing, SimulatorThread

pytestmark = pytest.mark.usefixtures("frequent")

SCENE_DATA = "woosh.map.SceneData"
FREE, UNKNOWN, OCCUPIED = 0, -1, 100
SCENE_WIDTH = 7
"""Width of the scene's map in these tests, in cells. Maps that are being made have other widths."""


class Mapping:
    """A simulated robot that reports what the test says, as a robot does that makes a map.

    Attributes:
        saved: the scenes' maps; the answer to each request for them.
        state: state of the robot in the first RobotInfo of a link; None for the simulator's own.
    """

    def __init__(self, simulator: SimulatorThread) -> None:
        self.saved = SceneData(name="wooshmap")
        self.saved.maps.add(
            name="wooshmap", resolution=0.5, origin=Pose2D(), map_png=png([[0] * SCENE_WIDTH])
        )
        self.state: int | None = None
        self._simulator = simulator
        simulator.intercept(self._change)

    def _change(self, frame: Outgoing) -> list[Outgoing]:
        if frame.request == SCENE_DATA:
            return [Outgoing(SCENE_DATA, self.saved, frame.sn, True, "", frame.request)]
        if frame.request == "woosh.robot.RobotInfo" and self.state is not None:
            assert frame.body is not None
            frame.body.state = self.state  # type: ignore[attr-defined]
        return [frame]

    def enter(self, state: int) -> None:
        """Report another state of the robot."""
        self.state = state
        self._simulator.push(RobotState(state=state))  # type: ignore[arg-type]

    def report(self, columns: int, **fields: Any) -> None:
        """Report a map that the robot is making, with so many columns of cells."""
        image = png([[255] * columns])
        default = {"map_data": image, "width": columns, "height": 1, "resolution": 0.05}
        self._simulator.push(BuildMapData(**{**default, **fields}))

    def grow(self, grids: Collector, columns: int, **fields: Any) -> Any:
        """Report a map every 0.1 s until the topic has it; return the message."""
        due = time.monotonic()

        def shown() -> Any:
            nonlocal due
            if time.monotonic() >= due:
                due += 0.1
                self.report(columns, **fields)
            return [each for each in grids.messages if each.info.width == columns]

        return wait_until(shown, f"a map of width {columns}")[0]


@pytest.fixture
def mapping(simulator: SimulatorThread) -> Mapping:
    return Mapping(simulator)


@pytest.fixture
def grids(mapping: Mapping, agent: RunningAgent, client: Client) -> Collector:
    """The messages on map. The scene's map has been received."""
    collector = client.echo(OccupancyGrid, "map")
    collector.wait_count(1)
    return collector


def visit(domain: int) -> closing[Client]:
    """Return a context with another ROS node."""
    return closing(Client(domain, name="visitor"))


def scene_maps(grids: Collector) -> int:
    """Return the number of messages with the scene's map."""
    return len([each for each in grids.messages if each.info.width == SCENE_WIDTH])


def test_each_new_report_is_shown_and_the_scenes_map_is_not_requested(
    mapping, grids, client, simulator
):
    requests = simulator.counts[SCENE_DATA]
    before = client.node.get_clock().now().nanoseconds
    mapping.enter(robot.kMapping)
    image = png([[255, 205, 0], [0, 255, 255]])
    fields = {"map_data": image, "height": 2, "origin_x": -1.5, "origin_y": -2.5}
    grid = mapping.grow(grids, 3, **fields)
    assert (grid.info.width, grid.info.height) == (3, 2)
    assert grid.info.resolution == pytest.approx(0.05)
    position, orientation = grid.info.origin.position, grid.info.origin.orientation
    assert (position.x, position.y, orientation.z, orientation.w) == (-1.5, -2.5, 0.0, 1.0)
    assert list(grid.data) == [OCCUPIED, FREE, FREE, FREE, UNKNOWN, OCCUPIED]
    assert grid.header.frame_id == "map"
    stamp = grid.header.stamp
    assert before <= stamp.sec * 10**9 + stamp.nanosec <= client.node.get_clock().now().nanoseconds
    assert grid.info.map_load_time == stamp
    mapping.grow(grids, 1)
    simulator.push(Scene(scene_name="wooshmap", map_name="wooshmap", version=99))
    # sizes that contradict the image are ignored
    grid = mapping.grow(grids, 4, width=2**31, height=0)
    assert (grid.info.width, grid.info.height) == (4, 1)
    assert simulator.counts[SCENE_DATA] == requests
    assert scene_maps(grids) == 1


def test_a_cancelled_map_gives_way_to_that_of_the_scene(mapping, grids):
    mapping.enter(robot.kMapping)
    mapping.grow(grids, 1)
    mapping.enter(robot.kUninit)
    wait_until(lambda: scene_maps(grids) == 2)
    assert grids.messages[-1].info.width == SCENE_WIDTH
    # the robot can make the map while nobody sees it grow; it has the same version
    mapping.enter(robot.kMapping)
    mapping.saved.maps[0].map_png = png([[255] * 9])
    mapping.enter(robot.kIdle)
    grids.wait(lambda m: m.info.width == 9)


def test_a_saved_map_is_shown_when_the_robot_has_left_the_state(mapping, grids, simulator):
    mapping.enter(robot.kMapping)
    mapping.grow(grids, 1)
    mapping.saved.maps[0].CopyFrom(
        SceneData.Map(name="new", resolution=0.1, map_png=png([[255] * 9]))
    )
    mapping.saved.name = "hall"
    simulator.push(Scene(scene_name="hall", map_name="new", map_id=5))
    mapping.grow(grids, 2)  # the robot writes its files for some seconds more
    mapping.enter(robot.kUninit)
    assert grids.wait(lambda m: m.info.width == 9).info.resolution == pytest.approx(0.1)
    assert simulator.last(SCENE_DATA).name == "hall"


def test_a_report_after_the_end_is_ignored(mapping, grids, client):
    mapping.enter(robot.kMapping)
    mapping.grow(grids, 1)
    mapping.enter(robot.kUninit)
    mapping.report(2)
    mapping.enter(robot.kWarning)  # a report in this state would be shown
    wait_until(lambda: scene_maps(grids) == 2)
    diagnostics(client).wait_count(5)  # what was published before has arrived
    assert not [each for each in grids.messages if each.info.width == 2]


def test_a_warning_or_fault_does_not_end_the_map_while_reports_come(mapping, grids, simulator):
    mapping.enter(robot.kMapping)
    mapping.grow(grids, 1)
    requests = simulator.counts[SCENE_DATA]
    mapping.enter(robot.kWarning)
    mapping.grow(grids, 2)
    mapping.enter(robot.kFault)
    mapping.grow(grids, 3)
    assert simulator.counts[SCENE_DATA] == requests
    wait_until(lambda: scene_maps(grids) == 2, "the scene's map, as no report comes any more")


def test_an_agent_that_starts_meanwhile_shows_the_growing_map(mapping, simulator, connect, client):
    mapping.state = robot.kMapping
    connect()
    grids = client.echo(OccupancyGrid, "map")
    mapping.grow(grids, 1)
    assert simulator.counts[SCENE_DATA] == 0


def test_after_a_lost_link_the_map_grows_on_or_the_scenes_map_is_shown(
    mapping, grids, agent, simulator
):
    mapping.enter(robot.kMapping)
    mapping.grow(grids, 1)
    simulator.drop()
    agent.wait_connected(2)
    mapping.grow(grids, 2)
    assert scene_maps(grids) == 1
    mapping.state = robot.kUninit  # the robot finishes meanwhile
    simulator.drop()
    wait_until(lambda: scene_maps(grids) == 2)
    simulator.drop()  # it may make a map meanwhile
    wait_until(lambda: scene_maps(grids) == 3)


class TestOnDemand:
    @pytest.mark.parametrize("without_link", [False, True])
    def test_a_late_subscriber_does_not_get_a_map_that_has_ended(
        self, mapping, agent, domain, simulator, without_link
    ):
        mapping.enter(robot.kMapping)
        for columns in (1, 2):
            with visit(domain) as visitor:
                mapping.grow(visitor.echo(OccupancyGrid, "map"), columns)
        requests = simulator.counts[SCENE_DATA]
        with visit(domain) as visitor:
            diagnostics(visitor).wait_count(20)  # for a second: the former subscriber has gone
        if without_link:
            mapping.state = robot.kIdle
            simulator.drop()
        else:
            mapping.enter(robot.kIdle)
        wait_until(lambda: simulator.counts[SCENE_DATA] > requests, "a request for the map")
        for _ in range(2):
            with visit(domain) as visitor:
                first = visitor.echo(OccupancyGrid, "map").wait_count(1)[0]
        assert first.info.width == SCENE_WIDTH


class TestBadReports:
    def test_they_are_logged_once_and_the_next_good_one_is_shown(self, mapping, grids, logs):
        mapping.enter(robot.kMapping)
        for number, (fields, text) in enumerate(
            (
                ({"map_data": b"no picture"}, "its image cannot be decoded"),
                ({"resolution": math.nan}, "its resolution is invalid: nan"),
                ({"origin_y": math.inf}, "origin is not finite"),
            )
        ):
            mapping.grow(grids, 10 + number)

            def reported(fields: Any = fields, text: str = text) -> bool:
                mapping.report(2, **fields)
                return len(logs.with_text(text)) > 1  # repeats are logged at DEBUG

            wait_until(reported)
            assert len(logs.with_text(text, "WARNING")) == 1
        mapping.grow(grids, 3)
        assert not [each for each in grids.messages if each.info.width == 2]


def test_tf_has_the_reported_pose_although_the_robot_has_no_map(
    mapping, simulator, connect, client
):
    connect(publish_tf=True)
    transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=1000))
    transforms.wait_count(1)
    mapping.enter(robot.kMapping)
    for step in range(3):
        pose = Pose2D(x=0.5 * step, y=-0.25, theta=0.125)
        simulator.push(PoseSpeed(pose=pose, twist=Twist(), map_id=0))
        transforms.wait(
            lambda m, x=pose.x: (
                abs(chain(m).x - x) < 1e-3
                and abs(chain(m).y + 0.25) < 1e-3
                and abs(chain(m).theta - 0.125) < 1e-3
            )
        )
