"""Info services: each call asks the chassis, and falls back on the last known value."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.convert.random_messages import blank
from tests.convert.type_pairs import field_class
from tests.harness import Client, Logs, Robot, RunningAgent, wait_until
from tests.node.goals import answer_with_json
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import QUERIES
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, RobotState
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc as TaskProcProto
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_msgs.msg import TaskProc
from woosh_robot_msgs.srv import Battery as BatterySrv
from woosh_robot_msgs.srv import RobotInfo
from woosh_robot_msgs.srv import RobotState as RobotStateSrv
from woosh_robot_msgs.srv import TaskProc as TaskProcSrv

BATTERY = "woosh.robot.Battery"
PATIENCE = 2
"""Timeout for answers of the agent `hasty`, in seconds; long enough for a slow machine."""
FALLBACK = "robot/Battery answers with the last known value"


@pytest.fixture
def hasty(simulator: Any, start_agent: Any) -> RunningAgent:
    """An agent with a short timeout for answers and a long back-off."""
    where = {"ip": "127.0.0.1", "port": simulator.port}
    agent = start_agent(**where, poll_timeout=PATIENCE * 1000, backoff_min=30.0, backoff_max=60.0)
    agent.wait_connected()
    return agent


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that tests of this file share, and its new chassis."""
    return shared_robot


def ask(client: Any, query: Any) -> Any:
    """Call a query; return the only field of its response."""
    response = client.call(class_of(query.srv, "srv"), query.name)
    (name,) = response.get_fields_and_field_types()
    return getattr(response, name)


def known(agent: RunningAgent, name: str) -> Any:
    return agent.agent.robot.last_known.get(name)


def test_an_answer_does_not_replace_a_newer_push(robot: Robot) -> None:
    """A push that the chassis sends right after the answer is newer, also in a burst of frames."""
    before = [Outgoing("woosh.robot.RobotState", RobotState(state=2))] * 3

    def answer(out: Outgoing) -> list[Outgoing]:
        if out.request != BATTERY:
            return [out]
        return [*before, replace(out, body=Battery(power=1)), Outgoing(BATTERY, Battery(power=2))]

    robot.chassis.intercept(answer)
    for _ in range(10):
        assert robot.call(BatterySrv, "robot/Battery").info.power == 1
        robot.call(RobotStateSrv, "robot/RobotState")  # until then, the push has arrived
        assert known(robot.agent, BATTERY).power == 2


def test_each_call_asks_the_chassis(robot: Robot) -> None:
    answers = {}

    def see(frame: Any) -> Any:
        answers[frame.request] = frame.body
        return [frame]

    robot.chassis.intercept(see)
    for query in QUERIES:
        cls = field_class(class_of(query.srv, "srv").Response)
        pack = converter(cls, message_type(query.request)).to_proto
        asked = robot.chassis.counts[query.request]
        for count in (1, 2):
            assert pack(ask(robot, query)) == answers[query.request], query.name
            assert robot.chassis.counts[query.request] == asked + count, query.name


def test_the_answer_to_a_query_with_an_argument_is_not_the_last_known_value(robot: Robot) -> None:
    """It may be about another task, or behind a gateway about another robot."""
    name = "woosh.robot.TaskProc"

    def answer(out: Outgoing) -> list[Outgoing]:
        is_asked = out.request == name
        return [replace(out, body=TaskProcProto(robot_task_id=17)) if is_asked else out]

    robot.chassis.intercept(answer)
    asked = TaskProc(robot_task_id=17, dest="A2")
    assert robot.call(TaskProcSrv, "robot/TaskProc", arg=asked).info.robot_task_id == 17
    sent = robot.chassis.last(name)
    assert (sent.robot_task_id, sent.dest) == (17, "A2"), "the only query with an argument"
    assert known(robot.agent, name).robot_task_id == 0
    robot.call(TaskProcSrv, "robot/TaskProc")
    assert known(robot.agent, name).robot_task_id == 17


def test_response_is_blank_while_nothing_is_known(start_agent, client, logs):
    start_agent(ip="127.0.0.1", port=1, poll_timeout=60_000)
    for query in QUERIES:
        info = ask(client, query)
        assert info == blank(info), query.name
        (warning,) = logs.with_text(f"{query.name} answers blank, because no value is known yet: ")
        assert warning.levelname == "WARNING"
        assert "not connected to ws://127.0.0.1:1 since 2" in warning.getMessage()


def test_without_a_link_the_last_answer_or_push_is_returned(simulator, hasty, client):
    answers = {query.name: ask(client, query) for query in QUERIES}
    simulator.push(RobotState(state=6))
    simulator.push(Battery(power=7, temp_max=9))
    wait_until(lambda: known(hasty, BATTERY).power == 7, "the pushes")
    simulator.stop_listening()
    wait_until(lambda: hasty.agent.robot.chassis.state.value == "waiting", "the link's end")
    for query in QUERIES:
        if query.name not in ("robot/Battery", "robot/RobotState", "robot/RobotInfo"):
            assert ask(client, query) == answers[query.name], query.name
    battery = client.call(BatterySrv, "robot/Battery").info
    assert (battery.power, battery.temp_max) == (7, 9)
    info = client.call(RobotInfo, "robot/RobotInfo").info
    assert info.battery == battery
    assert info.state.value == 6
    assert info.genral == answers["robot/General"]


NO_ANSWER = f"did not answer {BATTERY} within {PATIENCE} s"
BAD_ANSWERS = {
    "a refusal": (
        lambda simulator: simulator.refuse(BATTERY, "电池没电"),
        "the chassis refused: 电池没电",
    ),
    "none": (lambda simulator: simulator.mute(BATTERY), NO_ANSWER),
    "an unknown type": (
        lambda simulator: simulator.answer_as(BATTERY, "woosh.robot.Accumulator"),
        "unknown type 'woosh.robot.Accumulator'",
    ),
    "one that cannot be read": (
        lambda simulator: answer_with_json(simulator, BATTERY, body={"power": "full"}),
        "the answer cannot be read: woosh.robot.Battery: power",
    ),
}
"""Functions that let the chassis answer badly, and what the log then says.

The last one cannot be undone."""


def test_a_bad_answer_gives_the_last_known_value_and_is_logged_again_after_a_good_one(
    simulator: SimulatorThread, hasty: RunningAgent, client: Client, logs: Logs
) -> None:
    good = client.call(BatterySrv, "robot/Battery").info
    assert good.power > 0
    for spoil, why in BAD_ANSWERS.values():
        spoil(simulator)
        for _ in range(2):
            assert client.call(BatterySrv, "robot/Battery").info == good
        told = [record for record in logs.with_text(FALLBACK) if why in record.getMessage()]
        assert [record.levelname for record in told] == ["WARNING", "DEBUG"]
        simulator.accept(BATTERY)
        client.call(BatterySrv, "robot/Battery")
