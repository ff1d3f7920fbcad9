"""Goals whose link is lost."""

from __future__ import annotations

import math

import pytest

from tests.harness import Client, wait_until
from tests.node.goals import (
    ABORTED,
    CALL_ACTION,
    EXEC_TASK,
    EXECUTING,
    FEEDBACKS,
    STEP,
    SUCCEEDED,
    TASK_PROC,
    hurry,
    move_base,
    pause_task,
    short_task,
    slow_down,
    step,
    task,
)
from tests.node.link_loss.timeouts import short_timeouts
from tests.quick_chassis import quick_config
from woosh_robot_agent.pb.util import task_pb2
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.behaviour.jobs import Wait
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder

pytestmark = pytest.mark.usefixtures("agent")

WAITING = TaskOrder(6, task_pb2.kParking, dest="", jobs=lambda: [Wait(math.inf)])
"""A task of the chassis that does not end."""


def switch_off(simulator: SimulatorThread) -> None:
    simulator.stop_listening()
    wait_until(lambda: simulator.connections == 0)


# The link is lost and comes back


@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_goes_on_after_a_reconnect(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    slow_down(simulator)
    goal = task(client) if kind == "task" else step(client, 8.0)
    goal.feedback.wait_count(3)
    known = simulator.counts["woosh.robot.RobotInfo"]
    simulator.drop()
    simulator.wait_received("woosh.robot.RobotInfo", known + 1)
    count = len(goal.feedback.messages)
    hurry(simulator)
    goal.feedback.wait_count(count + 1)
    assert goal.result()[0] == SUCCEEDED
    assert simulator.counts[EXEC_TASK] + simulator.counts[CALL_ACTION] == 1, "nothing is replayed"


def test_goal_goes_on_after_repeated_losses(client: Client, simulator: SimulatorThread) -> None:
    slow_down(simulator)
    goal = task(client)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    pause_task(simulator)
    for _ in range(4):
        known = simulator.counts[TASK_PROC]
        simulator.drop()
        simulator.wait_received(TASK_PROC, known + 1)
    simulator.call(lambda sim: sim.chassis.tasks.resume())
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED


def test_task_that_ended_without_a_link_succeeds(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = short_task(client, 1.0)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    switch_off(simulator)
    wait_until(lambda: not simulator.call(lambda sim: sim.chassis.tasks.active))
    simulator.listen()
    assert goal.result()[0] == SUCCEEDED


def test_end_of_a_task_before_the_current_one_is_found_in_the_history(
    client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    goal = task(client, task_id=5)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    switch_off(simulator)
    simulator.call(lambda sim: sim.chassis.tasks.cancel("at the screen"))
    simulator.call(lambda sim: sim.chassis.tasks.start([WAITING]))
    simulator.listen()
    status, ret = goal.result()
    assert (status, ret.robot_task_id, ret.msg) == (ABORTED, 5, "at the screen")
    assert simulator.counts["woosh.robot.TaskHistory"] == 1


def test_action_that_ended_without_a_link_succeeds(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = step(client, 2.0)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    switch_off(simulator)
    wait_until(lambda: simulator.call(lambda sim: sim.chassis.actions.last[STEP].state == 1))
    simulator.listen()
    status, ret = goal.result()
    assert (status, ret.state.value) == (SUCCEEDED, 1)


def test_task_unknown_to_the_chassis_is_aborted(client: Client, simulator: SimulatorThread) -> None:
    goal = task(client)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    port = simulator.port
    switch_off(simulator)
    with SimulatorThread(quick_config(port=port, tcp_port=0)):
        status, ret = goal.result()
    assert status == ABORTED
    assert "does not know the task" in ret.msg


@short_timeouts
def test_action_unknown_to_the_chassis_is_aborted(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = move_base(client, 4.0)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    port = simulator.port
    switch_off(simulator)
    with SimulatorThread(quick_config(port=port, tcp_port=0)):
        status, ret = goal.result()
    assert (status, ret.state.value) == (ABORTED, -1)
    assert "link was lost" in ret.msg


def test_goal_goes_on_with_reports_though_polls_are_refused(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.refuse(FEEDBACKS, "unknown type")
    slow_down(simulator)
    goal = step(client, 15.0)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    known = simulator.counts["woosh.robot.RobotInfo"]
    simulator.drop()
    simulator.wait_received("woosh.robot.RobotInfo", known + 1)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED


# The link does not come back


@short_timeouts
@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_is_aborted_if_the_link_stays_lost(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    slow_down(simulator)
    goal = task(client, mark="A23") if kind == "task" else step(client, 100.0)
    goal.feedback.wait_count(1)
    simulator.stop_listening()
    status, ret = goal.result()
    assert status == ABORTED
    assert "link was lost" in ret.msg
    assert "0.8 s" in ret.msg
    assert ret.state.value == (9 if kind == "task" else -1)


def test_new_goal_without_a_link_is_aborted_and_not_sent_later(
    client: Client, simulator: SimulatorThread
) -> None:
    switch_off(simulator)
    status, ret = task(client).result()
    assert status == ABORTED
    assert "not connected to ws://127.0.0.1" in ret.msg
    simulator.listen()
    simulator.wait_received("woosh.robot.RobotInfo", 2)
    assert simulator.counts[EXEC_TASK] == 0
