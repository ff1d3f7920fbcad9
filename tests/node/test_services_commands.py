"""Command services: requests to the chassis, and responses to clients."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.convert.random_messages import blank, carried, random_proto, random_ros
from tests.convert.type_pairs import field_class
from tests.harness import Client, Robot, RunningAgent, wait_future, wait_until
from tests.node.goals import answer_with_json, replace_answers
from tests.node.test_parameters import change
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import COMMANDS, minimum_timeouts
from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.srv import Mode, PlanNavPath, SetSound, Speak, SwitchControlMode

SPEAK = "woosh.robot.Speak"
PLAN = "woosh.robot.PlanNavPath"


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that tests of this file share, and its new chassis."""
    return shared_robot


def srv_of(command: Any) -> Any:
    return class_of(command.srv, "srv")


def test_request_and_answer_pass_untouched(robot: Robot) -> None:
    rng = random.Random(7)
    for number, command in enumerate(COMMANDS):
        ok = number % 2 == 0
        arg = random_ros(rng, field_class(srv_of(command).Request, "arg"))
        if command.name == "robot/Twist":  # beyond the limits, it would be changed or refused
            arg = type(arg)(linear=0.25, angular=-0.5)
        msg = "请求失败: \n\u00e9 🤖" + command.name
        changes = {"ok": ok, "msg": msg, "type": command.answer or command.request, "body": None}
        if command.answer:
            ret_class = field_class(srv_of(command).Response, "ret")
            proto_class = message_type(command.answer)
            changes["body"] = random_proto(rng, proto_class, ret_class)
        robot.chassis.refuse(command.request, "not done")
        undo = robot.chassis.intercept(
            lambda f, changes=changes: [replace(f, **changes) if f.request else f]
        )
        response = robot.call(srv_of(command), command.name, arg=arg)
        undo()
        sent = robot.chassis.last(command.request)
        assert sent == converter(type(arg), type(sent)).to_proto(carried(arg)), command.name
        assert (response.ok, response.msg) == (ok, msg)
        if command.answer:
            ret = converter(ret_class, proto_class).to_ros(changes["body"])
            assert response.ret == ret, command.name


def test_ok_and_msg_are_used_even_with_a_body_of_another_type(robot: Robot) -> None:
    for kind in ("woosh.robot.Battery", "woosh.robot.Unheard", "error"):
        changes = {"ok": True, "msg": "done", "type": kind, "body": None}
        undo = robot.chassis.intercept(
            lambda f, changes=changes: [replace(f, **changes) if f.request else f]
        )
        response = robot.call(SwitchControlMode, "robot/SwitchControlMode")
        assert (response.ok, response.msg) == (True, "done")
        assert response.ret == blank(response.ret)
        assert robot.call(Speak, "robot/Speak").ok
        undo()


def test_call_without_a_link_fails_with_the_reason(start_agent, client):
    agent = start_agent(ip="127.0.0.1", port=1, poll_timeout=60_000)
    wait_until(lambda: agent.agent.robot.chassis.last_error, "the first attempt")
    for command in COMMANDS[::10]:
        response = client.call(srv_of(command), command.name)
        assert not response.ok
        assert "not connected to ws://127.0.0.1:1 since 2" in response.msg, command.name
        assert "Connection refused" in response.msg


def test_call_fails_if_the_link_is_lost_and_is_not_repeated(robot: Robot) -> None:
    robot.chassis.mute(SPEAK)
    call = robot.call_async(Speak, "robot/Speak")
    robot.chassis.wait_received(SPEAK)
    robot.chassis.drop()
    response = wait_future(call)
    assert not response.ok
    assert f"lost the link to ws://127.0.0.1:{robot.chassis.port}" in response.msg
    assert SPEAK in response.msg
    wait_until(
        lambda: (
            robot.chassis.counts["woosh.robot.RobotInfo"] == 2
            and robot.link.state is LinkState.READY
        ),
        "the next link",
    )
    robot.chassis.accept(SPEAK)
    assert robot.call(Speak, "robot/Speak", arg=SpeakMsg(text="new")).ok
    assert [r.message.text for r in robot.chassis.received if r.type == SPEAK] == ["", "new"]


# Values that must not reach the robot


def test_bad_values_are_named_and_not_sent(robot: Robot) -> None:
    """tests/convert has values in lists and oneofs."""
    for name, values, path in (
        ("robot/InitRobot", {"pose": {"theta": math.nan}}, "arg.pose.theta"),
        ("robot/Twist", {"linear_y": -math.inf}, "arg.linear_y"),
        ("robot/PlanNavPath", {"end": {"x": math.inf}}, "arg.end.x"),
    ):
        response = robot.command(name, **values)
        assert not response.ok
        assert response.msg.startswith(path)
        assert not robot.chassis.counts[f"woosh.{name.replace('/', '.')}"]


# The robot id, and old clients


def test_configured_robot_id_is_sent_unless_the_client_sets_one(simulator, connect, client):
    connect(robot_id=4_000_000_000)
    own = SetSound.Request().arg
    own.request.which = own.request.REQUEST_ROBOT_ID_SET
    for arg, robot_id in ((SetSound.Request().arg, 4_000_000_000), (own, 0)):
        client.call(SetSound, "setting/Sound", arg=arg)
        sent = simulator.last("woosh.robot.setting.Sound")
        assert (sent.WhichOneof("request"), sent.robot_id) == ("robot_id", robot_id)
    client.call(Mode, "robot/Mode")
    assert simulator.last("woosh.robot.Mode").robot_id == 4_000_000_000


def test_no_robot_id_is_sent_by_default(robot: Robot) -> None:
    robot.call(SetSound, "setting/Sound")
    assert robot.chassis.last("woosh.robot.setting.Sound").WhichOneof("request") is None


# PlanNavPath, whose answer is of another type than the request names


def test_a_planned_path_is_read_whatever_type_the_answer_names(
    simulator: SimulatorThread, connect: Callable[..., RunningAgent], client: Client
) -> None:
    agent = connect(encoding="protobuf")
    path = NavPath()
    path.path.poses.add(x=1.0, y=2.0)
    for links, named in ((1, PLAN), (2, "woosh.robot.NavPath")):
        agent.wait_connected(links)
        replace_answers(simulator, PLAN, ok=True, msg="", type=named, body=path)
        response = client.call(PlanNavPath, "robot/PlanNavPath")
        assert response.ok, response.msg
        assert [(pose.x, pose.y) for pose in response.ret.path.poses] == [(1.0, 2.0)]
        if links == 1:
            assert change(client, encoding="json") == (True, "")


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


# Timeouts of answers: `poll_timeout`, and the longer ones of slow requests

INIT_ROBOT = "woosh.robot.InitRobot"
LONGEST_ANSWERS = {
    "woosh.robot.BuildMap": 235.538,
    "woosh.robot.NavPath": 8.833,
    "woosh.robot.SwitchWorkMode": 6.469,
    INIT_ROBOT: 4.9,
    "woosh.robot.RobotInfo": 3.497,
    "woosh.map.SceneData": 4.562,
    "woosh.map.Download": 9.789,
    "woosh.map.Upload": 5.141,
}
"""Longest answer times of a real robot, in seconds."""


def test_a_slow_request_has_its_minimum_or_a_longer_poll_timeout(
    connect: Callable[..., RunningAgent], client: Client, simulator: SimulatorThread
) -> None:
    chassis = connect(poll_timeout=1000).agent.robot.chassis
    simulator.delay(INIT_ROBOT, 1.5)
    response = client.command("robot/InitRobot", is_record=True)
    assert (response.ok, "did not answer" in response.msg) == (True, False), response.msg
    assert change(client, poll_timeout=40_000) == (True, "")
    wait_until(lambda: chassis.timeout_of(INIT_ROBOT) == 40.0, "the new settings")
    assert chassis.timeout_of("woosh.robot.BuildMap") == minimum_timeouts()["woosh.robot.BuildMap"]
    assert chassis.timeout_of("woosh.robot.Speak") == 40.0


def test_the_longest_real_answers_fit_twice() -> None:
    for request, longest in LONGEST_ANSWERS.items():
        assert minimum_timeouts().get(request, 10.0) >= 2 * longest, request
