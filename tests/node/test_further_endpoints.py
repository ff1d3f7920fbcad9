"""Endpoints that the manufacturer's agent lacks, as far as they differ from the others."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.harness import Client, Robot, RunningAgent, fill, wait_future
from tests.node.goals import Held, answer_with_json, replace_answers
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import BuildMap as BuildMapMsg
from woosh_robot_msgs.msg import BuildMapBuildType
from woosh_robot_msgs.srv import BuildMap, PlanNavPath, RobotState

BUILD_MAP, PLAN = "woosh.robot.BuildMap", "woosh.robot.PlanNavPath"


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def planned() -> NavPath:
    path = NavPath()
    path.path.poses.add(x=1.0, y=2.0)
    path.path.poses.add(x=3.0, y=4.0)
    return path


@pytest.mark.parametrize(
    ("named", "encoding"), [(PLAN, "protobuf"), ("woosh.robot.NavPath", "json")]
)
def test_a_planned_path_is_read_whatever_type_the_answer_names(
    simulator: SimulatorThread,
    connect: Callable[..., RunningAgent],
    client: Client,
    named: str,
    encoding: str,
) -> None:
    connect(encoding=encoding)
    replace_answers(simulator, PLAN, ok=True, msg="", type=named, body=planned())
    response = client.call(PlanNavPath, "robot/PlanNavPath")
    assert response.ok, response.msg
    assert [(pose.x, pose.y) for pose in response.ret.path.poses] == [(1.0, 2.0), (3.0, 4.0)]


def test_a_read_without_a_usable_answer_fails(robot: Robot) -> None:
    def asked() -> tuple[bool, str, int]:
        response = robot.call(PlanNavPath, "robot/PlanNavPath")
        return response.ok, response.msg, len(response.ret.path.poses)

    replace_answers(robot.chassis, PLAN, ok=True, msg="", type=PLAN, body=None)
    assert asked() == (True, "", 0), "an echo of the request is an empty path"
    replace_answers(robot.chassis, PLAN, type="woosh.robot.Battery")
    reason = "no usable answer: the chassis answered with woosh.robot.Battery, not with "
    assert asked() == (False, f"{reason}woosh.robot.NavPath", 0)
    answer_with_json(robot.chassis, PLAN, type="woosh.robot.NavPath", body={"path": 7})
    assert asked()[1].startswith("no usable answer: the answer cannot be read: woosh.robot.NavPa")


def test_a_long_request_delays_no_other(robot: Robot) -> None:
    """A real robot once took 236 s to save a map."""
    assert robot.link.timeout_of(BUILD_MAP) == 600.0
    held = Held(robot.chassis, BUILD_MAP)
    save = fill(BuildMapMsg(), type=BuildMapBuildType.K_SAVE)
    saving = robot.call_async(BuildMap, "robot/BuildMap", arg=save)
    robot.chassis.wait_received(BUILD_MAP)
    assert robot.call(RobotState, "robot/RobotState").info.state.value
    assert robot.command("robot/SwitchControlMode", mode=1).ok
    assert not saving.done()
    held.release()
    assert wait_future(saving).msg
