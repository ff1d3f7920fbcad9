"""robot/ExecTask, with a chassis that behaves well and with one that does not."""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.harness import Client, wait_until
from tests.node.goals import (
    ABORTED,
    ACTION_ORDER,
    CANCELED,
    COMPLETED,
    EXEC_TASK,
    EXECUTING,
    FAILED,
    SUCCEEDED,
    TASK_CANCELED,
    TASK_PROC,
    hurry,
    pause_task,
    proc,
    set_timing,
    short_task,
    slow_down,
    task,
)
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_msgs.action import ExecTask
from woosh_robot_msgs.srv import SwitchControlMode

pytestmark = pytest.mark.usefixtures("agent")


def test_task_succeeds_with_each_report_as_feedback(
    client: Client, simulator: SimulatorThread
) -> None:
    before = int(time.time())
    goal = task(client)
    status, ret = goal.result()
    assert status == SUCCEEDED
    assert ret.state.value == COMPLETED
    assert ret.dest == "A2"
    sent = simulator.last(EXEC_TASK)
    assert before <= sent.task_id == ret.robot_task_id
    goal.feedback.wait(lambda fb: fb.state.value == COMPLETED)
    states = [fb.state.value for fb in goal.feedback.messages]
    assert states[-1] == COMPLETED
    assert EXECUTING in states
    assert {fb.robot_task_id for fb in goal.feedback.messages} == {sent.task_id}


def test_task_id_is_the_clients_or_a_new_one(client: Client, simulator: SimulatorThread) -> None:
    assert short_task(client, 0.05, task_id=77).result()[1].robot_task_id == 77
    ids = [short_task(client, x).result()[1].robot_task_id for x in (0.1, 0.2, 0.3)]
    assert len(set(ids)) == 3
    assert [each.message.task_id for each in simulator.received if each.type == EXEC_TASK] == [
        77,
        *ids,
    ]


def test_refusal_reaches_the_client(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(EXEC_TASK, "robot is in manual mode: turn the key switch")
    goal = task(client, task_id=5)
    status, ret = goal.result()
    assert status == ABORTED
    assert ret.msg == "robot is in manual mode: turn the key switch"
    assert ret.state.value == FAILED
    assert ret.robot_task_id == 5
    assert not goal.feedback.messages


def test_refusal_without_a_reason_is_explained(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(EXEC_TASK, "")
    status, ret = task(client).result()
    assert status == ABORTED
    assert "refused" in ret.msg


def test_failed_task_is_aborted(client: Client, simulator: SimulatorThread) -> None:
    slow_down(simulator)
    goal = task(client, task_id=6)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    simulator.push(proc(6, FAILED, "wheel slips"))
    assert (goal.result()[0], goal.result()[1].msg) == (ABORTED, "wheel slips")


def test_task_cancelled_by_another_client_is_aborted(
    client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    goal = task(client)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    simulator.call(lambda sim: sim.chassis.tasks.cancel("cancelled at the screen"))
    status, ret = goal.result()
    assert (status, ret.msg) == (ABORTED, "cancelled at the screen")
    assert ret.state.value == TASK_CANCELED


def test_reports_on_other_tasks_are_ignored(client: Client, simulator: SimulatorThread) -> None:
    goal = short_task(client, 1.0, task_id=8)
    for state in (EXECUTING, COMPLETED, FAILED, TASK_CANCELED):
        simulator.push(proc(7, state, "of another task"))
    status, _ = goal.result()
    assert status == SUCCEEDED
    goal.feedback.wait(lambda fb: fb.state.value == COMPLETED)
    assert {fb.robot_task_id for fb in goal.feedback.messages} == {8}


@pytest.mark.parametrize(("field", "path"), [("x", "arg.pose.x"), ("theta", "arg.pose.theta")])
def test_nan_is_not_sent(client: Client, simulator: SimulatorThread, field: str, path: str) -> None:
    goal = ExecTask.Goal()
    setattr(goal.arg.pose, field, math.nan)
    status, ret = client.send_goal(ExecTask, "robot/ExecTask", goal).result()
    assert status == ABORTED
    assert path in ret.msg
    assert "nothing was sent" in ret.msg
    assert simulator.counts[EXEC_TASK] == 0


def test_the_replacement_character_is_sent(client: Client, simulator: SimulatorThread) -> None:
    task(client, "a\ufffd谢").result()
    assert simulator.last(EXEC_TASK).mark_no == "a\ufffd谢"


def test_task_in_manual_mode_is_refused(client: Client, simulator: SimulatorThread) -> None:
    request = SwitchControlMode.Request()
    request.arg.mode.value = 2
    assert client.call(SwitchControlMode, "robot/SwitchControlMode", arg=request.arg).ok
    status, ret = task(client).result()
    assert status == ABORTED
    assert "manual mode" in ret.msg


def test_newer_task_replaces_an_older_one(client: Client, simulator: SimulatorThread) -> None:
    slow_down(simulator)
    old = task(client, task_id=11)
    old.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    new = task(client, mark="U5", task_id=12)
    status, ret = old.result()
    assert status == ABORTED
    assert ret.msg == REPLACED
    hurry(simulator)
    assert new.result()[0] == SUCCEEDED
    assert simulator.counts[ACTION_ORDER] == 0


def test_older_task_is_replaced_even_if_its_end_comes_late(
    client: Client, simulator: SimulatorThread
) -> None:
    late: list = []

    def hold(out):  # type: ignore[no-untyped-def]
        cancelled = out.type == TASK_PROC and out.body.robot_task_id == 11
        if cancelled and out.body.state == TASK_CANCELED and not late:
            late.append(out.body)
            return []
        return [out]

    slow_down(simulator)
    old = task(client, task_id=11)
    old.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    simulator.intercept(hold)
    new = task(client, mark="U5", task_id=12)
    status, ret = old.result()
    assert (status, ret.msg) == (ABORTED, REPLACED)
    simulator.push(late[0])
    hurry(simulator)
    assert new.result()[0] == SUCCEEDED


def test_refused_newer_task_does_not_replace_the_older_one(
    client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    old = task(client)
    old.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    new = task(client, mark="nowhere")
    status, ret = new.result()
    assert (status, "nowhere" in ret.msg) == (ABORTED, True)
    hurry(simulator)
    assert old.result()[0] == SUCCEEDED


def test_newer_task_with_the_same_id_replaces_the_older_one(
    client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    old = task(client, task_id=9)
    old.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    new = task(client, mark="U5", task_id=9)
    status, ret = old.result()
    assert (status, ret.msg) == (ABORTED, REPLACED)
    hurry(simulator)
    status, ret = new.result()
    assert (status, ret.dest) == (SUCCEEDED, "U5")


@pytest.mark.parametrize("state", [COMPLETED, TASK_CANCELED, FAILED])
def test_late_end_of_an_older_task_with_the_same_id_is_ignored(
    client: Client, simulator: SimulatorThread, state: int
) -> None:
    assert short_task(client, 0.1, task_id=9).result()[0] == SUCCEEDED
    late = Outgoing(TASK_PROC, proc(9, state, "the old end"))
    simulator.intercept(lambda out: [late, out] if out.request == EXEC_TASK else [out])
    second = task(client, mark="U5", task_id=9)
    status, ret = second.result()
    assert (status, ret.dest) == (SUCCEEDED, "U5")


def test_twenty_tasks_in_a_row_succeed(client: Client) -> None:
    ends = [short_task(client, 0.05 * i).result() for i in range(1, 21)]
    assert [status for status, _ in ends] == [SUCCEEDED] * 20
    assert len({ret.robot_task_id for _, ret in ends}) == 20


def test_last_of_two_simultaneous_tasks_wins(client: Client, simulator: SimulatorThread) -> None:
    slow_down(simulator)
    with ThreadPoolExecutor() as pool:
        goals = list(pool.map(lambda number: task(client, task_id=number), (1, 2)))
    simulator.wait_received(EXEC_TASK, 2)
    hurry(simulator)
    ends = {goal.result()[0]: goal.result()[1] for goal in goals}
    sent = [each.message.task_id for each in simulator.received if each.type == EXEC_TASK]
    assert (ends[ABORTED].robot_task_id, ends[SUCCEEDED].robot_task_id) == tuple(sent)
    assert ends[ABORTED].msg == REPLACED


def test_lost_end_is_found_by_polling(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.3)
    ended = (COMPLETED,)
    simulator.intercept(
        lambda out: (
            [] if out.type == TASK_PROC and not out.sn and out.body.state in ended else [out]
        )
    )
    goal = task(client)
    status, ret = goal.result()
    assert (status, ret.state.value) == (SUCCEEDED, COMPLETED)
    assert simulator.counts[TASK_PROC] > 0


def test_paused_task_is_polled_at_the_poll_period(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.2)
    slow_down(simulator)
    goal = task(client)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    pause_task(simulator)
    begun = time.monotonic()
    asked = simulator.counts[TASK_PROC]
    wait_until(lambda: simulator.counts[TASK_PROC] >= asked + 4)
    assert time.monotonic() - begun > 0.5
    paused = [fb for fb in goal.feedback.messages if fb.state.value == 4]
    assert len(paused) == 1, "a repeated report is no feedback"
    goal.cancel()
    assert goal.result()[0] == CANCELED
