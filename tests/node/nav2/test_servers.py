"""The states of Nav2's nodes, the map server, amcl_pose, and speed_limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.srv import GetState
from nav_msgs.srv import GetMap
from std_srvs.srv import Trigger

from tests.harness import Logs, Robot, wait_until
from tests.node.goals import START, hurry, move_base, slow_down, stop_time, task
from tests.node.nav2.goals import SUCCEEDED, go, navigates, stands
from tests.node.test_parameters import change
from woosh_map_msgs.srv import SceneList
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ChangeNavMode, SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.ros.nav2 import pose
from woosh_robot_agent.ros.standard_endpoints import MANAGERS
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.world.geometry import Pose

pytest.importorskip("nav2_msgs.action")


MOVE_BASE = "woosh.ros.action.MoveBase"


def state(robot: Robot, node: str) -> str:
    return str(robot.call(GetState, f"{node}/get_state").current_state.label)


def is_active(robot: Robot, manager: str) -> bool:
    return bool(robot.call(Trigger, f"{manager}/is_active").success)


class TestLifecycle:
    def test_states_of_nodes_and_managers(self, robot: Robot) -> None:
        assert [state(robot, node) for node in ("bt_navigator", "amcl")] == ["active"] * 2
        assert [is_active(robot, manager) for manager in MANAGERS] == [True] * 2
        slow_down(robot.chassis)
        running = task(robot)
        running.feedback.wait(lambda _: True)
        assert state(robot, "bt_navigator") == "active", "also while it executes a task"
        robot.chassis.set_emergency_stop(True)
        wait_until(lambda: state(robot, "bt_navigator") == "inactive", "the state")
        assert not is_active(robot, MANAGERS[0])
        robot.chassis.inject("off")
        wait_until(lambda: state(robot, "amcl") == "inactive", "the state without a link")
        assert state(robot, "bt_navigator") == "inactive"

    def test_amcl_is_active_while_the_robot_is_lost(self, robot: Robot) -> None:
        """Clients set the pose only after that."""
        robot.chassis.lose_localisation()
        wait_until(lambda: state(robot, "bt_navigator") == "inactive", "the state")
        assert state(robot, "amcl") == "active"

    def test_managers_answer_what_is_true(self, robot: Robot, logs: Logs) -> None:
        manage = class_of("nav2_msgs/ManageLifecycleNodes", "srv")

        def success(command: str) -> set[bool]:
            number = getattr(manage.Request, command)
            answers = [
                robot.call(manage, f"{each}/manage_nodes", command=number) for each in MANAGERS
            ]
            return {answer.success for answer in answers}

        assert success("STARTUP") == success("RESUME") == {True}
        assert not logs.with_text("is not possible")
        assert success("PAUSE") == success("RESET") == success("SHUTDOWN") == {False}
        assert logs.with_text("is not possible")


class TestMapServer:
    def load(self, robot: Robot, url: str) -> Any:
        return robot.call(class_of("nav2_msgs/LoadMap", "srv"), "map_server/load_map", map_url=url)

    def test_another_map_is_loaded_by_the_name_of_its_file(self, robot: Robot) -> None:
        grid = robot.call(GetMap, "map_server/map").map
        assert grid.header.frame_id == "map"
        assert len(grid.data) == grid.info.width * grid.info.height > 0
        current = robot.chassis.state.info.scene.map_name
        scenes = robot.call(SceneList, "map/SceneList").info.scenes
        other = next(name for scene in scenes for name in scene.maps if name != current)
        refusal = robot.chassis.inject("refuse", type=SwitchMap.DESCRIPTOR.full_name)
        answer = self.load(robot, other)
        assert answer.result == answer.RESULT_UNDEFINED_FAILURE
        refusal.clear()
        answer = self.load(robot, f"/maps/{other}.yaml")
        assert answer.result == answer.RESULT_SUCCESS
        assert robot.chassis.state.info.scene.map_name == other
        assert answer.map.data == robot.call(GetMap, "map_server/map").map.data
        assert self.load(robot, other).result == answer.RESULT_SUCCESS
        assert robot.chassis.counts[SwitchMap.DESCRIPTOR.full_name] == 2, "it is loaded already"

    def test_without_a_link_the_map_is_not_known(self, robot: Robot) -> None:
        """The robot may come back with another one."""
        current = robot.chassis.state.info.scene.map_name
        robot.chassis.inject("off")
        wait_until(lambda: state(robot, "amcl") == "inactive", "the lost link")
        answer = self.load(robot, current)
        assert answer.result == answer.RESULT_UNDEFINED_FAILURE

    def test_there_is_no_such_map(self, robot: Robot, logs: Logs) -> None:
        answer = self.load(robot, "nowhere.yaml")
        assert answer.result == answer.RESULT_MAP_DOES_NOT_EXIST
        assert not answer.map.data
        logs.wait_text("the robot has no map nowhere")
        assert SwitchMap.DESCRIPTOR.full_name not in robot.chassis.counts


def test_costmaps_are_cleared_without_an_effect(robot: Robot, logs: Logs) -> None:
    clear = class_of("nav2_msgs/ClearEntireCostmap", "srv")
    for costmap in ("global", "local"):
        robot.call(clear, f"{costmap}_costmap/clear_entirely_{costmap}_costmap")
    said = logs.with_text("costmap has no effect")
    assert len(said) == 1


def test_amcl_pose_follows_the_robot_and_each_initialpose(own_robot: Robot) -> None:
    robot = own_robot
    poses = robot.echo(PoseWithCovarianceStamped, "amcl_pose", depth=10)
    first = poses.wait(lambda _: True)
    assert first.header.frame_id == "map"
    assert first.pose.pose.position.x == pytest.approx(START[0], abs=0.01)
    assert first.pose.covariance[0] > 0.0
    publisher = robot.publisher(PoseWithCovarianceStamped, "initialpose")
    for count in (2, 3):  # also if it stays the same
        publisher.publish(first)
        again = poses.wait_count(count)[-1]
        assert again.pose.pose.position.x == pytest.approx(START[0], abs=0.01)
    assert go(robot, 1.0).result()[0] == SUCCEEDED
    poses.wait(lambda each: each.pose.pose.position.x > START[0] + 0.7)


def test_amcl_pose_is_the_new_one_after_a_small_correction(
    own_robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot may report the old pose for a moment."""
    monkeypatch.setattr(pose, "POSE_SET_INTERVAL", 60.0)
    robot = own_robot
    poses = robot.echo(PoseWithCovarianceStamped, "amcl_pose", depth=10)
    corrected = deepcopy(poses.wait(lambda _: True))
    reports: list[PoseSpeed] = []
    robot.chassis.intercept(  # only the reports of this test; also no answer to a query
        lambda out: [out] if out.type != full_name(PoseSpeed) or out.body in reports else []
    )
    corrected.pose.pose.position.x += 0.1
    asked = robot.chassis.counts[full_name(PoseSpeed)]
    robot.publisher(PoseWithCovarianceStamped, "initialpose").publish(corrected)
    # when the pose is set, the agent asks for it
    robot.chassis.wait_received(full_name(PoseSpeed), asked + 1)
    for x in (START[0], START[0] + 0.1):
        report = PoseSpeed()
        report.CopyFrom(robot.chassis.state.info.pose_speed)
        report.pose.x = x
        reports.append(report)
        robot.chassis.push(report)
    poses.wait(lambda each: each.pose.pose.position.x == pytest.approx(START[0] + 0.1, abs=0.01))


class TestSpeedLimit:
    @pytest.fixture
    def robot(self, own_robot: Robot) -> Robot:
        """An agent keeps its limit, so each test has its own."""
        return own_robot

    @pytest.fixture
    def limit(self, robot: Robot) -> Callable[..., None]:
        """Function that publishes a limit."""
        message = class_of("nav2_msgs/SpeedLimit")
        publisher = robot.publisher(message, "speed_limit", depth=1)
        return lambda **fields: publisher.publish(message(**fields))

    def sent(self, robot: Robot, kind: type[Any]) -> list[float]:
        """Return the limits that the chassis has got, in m/s."""
        modes = [
            each.message.nav_mode
            for each in robot.chassis.received
            if type(each.message) is kind and each.message.HasField("nav_mode")
        ]
        return [round(mode.max_speed, 3) for mode in modes]

    def test_each_navigation_gets_it_until_it_is_taken_back(
        self, robot: Robot, limit: Callable[..., None]
    ) -> None:
        slow_down(robot.chassis)
        limit(speed_limit=0.3)
        for distance in (1.0, 0.5):
            goal = go(robot, distance)
            goal.feedback.wait(lambda each: each.navigation_time.nanosec > 600_000_000)
            speed = robot.chassis.state.velocity.speed
            assert speed <= 0.31
            hurry(robot.chassis)
            assert goal.result()[0] == SUCCEEDED
            slow_down(robot.chassis)
        assert set(self.sent(robot, CallAction)) == {0.3}
        assert len(self.sent(robot, CallAction)) >= 2
        goal = go(robot, 3.0)
        wait_until(lambda: not stands(robot.chassis), "the robot drives")
        limit(speed_limit=0.0)
        wait_until(lambda: self.sent(robot, CallAction)[-1] == 0.0, "the limit is taken back")
        hurry(robot.chassis)
        assert goal.result()[0] == SUCCEEDED
        before = len(self.sent(robot, CallAction))
        assert go(robot, 1.0).result()[0] == SUCCEEDED
        assert len(self.sent(robot, CallAction)) == before

    def test_the_kinds_of_limits(self, robot: Robot, limit: Callable[..., None]) -> None:
        """The chassis takes a limit as its speed, so a high one would make the robot faster."""

        def last_sent(**fields: Any) -> float:
            if fields:
                limit(**fields)
            for distance in (0.5, 1.0):  # the first drive may begin before the limit comes
                assert go(robot, distance).result()[0] == SUCCEEDED
            return self.sent(robot, CallAction)[-1]

        assert last_sent(percentage=True, speed_limit=40.0) == 0.4
        assert change(robot, cmd_vel_max_linear=0.5) == (True, "")
        assert last_sent() == 0.2, "a percentage of the present maximum"
        assert last_sent(percentage=True, speed_limit=250.0) == 0.0, "no limit"
        # that of cmd_vel says nothing about the speed of navigation
        assert change(robot, cmd_vel_max_linear=0.2) == (True, "")
        assert last_sent(speed_limit=0.5) == 0.5
        assert last_sent(speed_limit=1.0) == 0.0, "the highest speed is no limit"

    def test_a_task_gets_it_too_even_one_that_comes_without_a_link(
        self, robot: Robot, limit: Callable[..., None]
    ) -> None:
        slow_down(robot.chassis)
        limit(speed_limit=0.5)
        task(robot, mark="A23")
        wait_until(lambda: self.sent(robot, ChangeNavMode) == [0.5], "the limit is sent")
        switched_off = robot.chassis.inject("off")
        robot.wait_lost()
        limit(speed_limit=0.2)
        switched_off.clear()
        wait_until(lambda: self.sent(robot, ChangeNavMode)[-1] == 0.2, "the new limit is sent")

    @pytest.mark.parametrize("told", [True, False], ids=["", "the robot tells nothing of it"])
    def test_one_that_comes_without_a_link_is_sent_when_the_link_is_back(
        self, robot: Robot, limit: Callable[..., None], told: bool
    ) -> None:
        slow_down(robot.chassis)
        if not told:
            robot.chassis.inject("refuse", type="woosh.ros.Feedbacks")
        go(robot, 5.0)
        wait_until(lambda: not stands(robot.chassis), "the robot drives")
        switched_off = robot.chassis.inject("off")
        robot.wait_lost()
        limit(speed_limit=0.2)
        stop_time(robot.chassis)  # so that no further report comes
        switched_off.clear()
        wait_until(lambda: self.sent(robot, CallAction) == [0.2], "the limit is sent")

    def test_another_clients_navigation_gets_it_after_a_loss_of_the_link(
        self, robot: Robot, limit: Callable[..., None]
    ) -> None:
        """Also if the navigation before ended during the loss, without a report."""
        slow_down(robot.chassis)
        limit(speed_limit=0.3)
        goal = go(robot, 1.0)
        wait_until(lambda: self.sent(robot, CallAction) == [0.3], "the limit is sent")
        switched_off = robot.chassis.inject("off")
        robot.wait_lost()
        hurry(robot.chassis)
        wait_until(lambda: not navigates(robot), "the end of the navigation")
        switched_off.clear()
        goal.result()
        slow_down(robot.chassis)
        robot.chassis.call(
            lambda sim: sim.chassis.ownership.start_action(MOVE_BASE, Navigate(Pose(*START)))
        )
        wait_until(lambda: self.sent(robot, CallAction) == [0.3] * 2, "the limit is sent")

    def test_a_refused_limit_ends_a_navigation(
        self, robot: Robot, limit: Callable[..., None], logs: Logs
    ) -> None:
        """Without its limit, the robot would drive faster than it should."""
        slow_down(robot.chassis)
        for value in (-1.0, math.nan):
            limit(speed_limit=value)
            logs.wait_text(f"speed_limit is ignored, because it is {value:g}")
        limit(speed_limit=0.001)
        go(robot, 5.0).wait_aborted("the robot refused the speed limit of 0.001 m/s")
        assert stands(robot.chassis)
        # one that is not of Nav2 goes on
        logs.messages.clear()
        goal = move_base(robot, 1.0)
        logs.wait_text("refused the speed limit")
        hurry(robot.chassis)
        assert goal.result()[0] == SUCCEEDED
