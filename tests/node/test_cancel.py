"""Cancelling goals, with cancel requests, the chassis's answers and its reports in any order."""

from __future__ import annotations

import threading

import pytest
from action_msgs.srv import CancelGoal

from tests.harness import Client, GoalClient, Logs, Robot, wait_until
from tests.node.goals import (
    ACTION,
    ACTION_ORDER,
    CALL_ACTION,
    CANCELED,
    COMPLETED,
    EXEC_TASK,
    EXECUTING,
    FEEDBACKS,
    STEP,
    SUCCEEDED,
    TASK_CANCELED,
    TASK_PROC,
    Held,
    Kind,
    each_kind,
    hurry,
    lift,
    lift3,
    proc,
    replace_answers,
    short_task,
    slow_down,
    step,
    task,
    until,
    without_reports,
)
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_msgs.msg import TaskProc
from woosh_robot_msgs.srv import RobotState

ACTIONS = ("robot/ExecTask", "ros/StepControl", "ros/LiftControl", "ros/LiftControl3")


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


@pytest.fixture(autouse=True)
def unhurried(robot: Robot) -> None:
    """Slow simulated time down, so that no goal ends before it is cancelled."""
    slow_down(robot.chassis)


def driving(robot: Robot) -> GoalClient:
    """Start a task, and wait until the robot drives."""
    return until(task(robot), EXECUTING)


def cancel_everything(client: Client, name: str) -> CancelGoal.Response:
    return client.call(CancelGoal, f"{name}/_action/cancel_goal")


def test_action_can_be_cancelled_before_its_first_report(robot: Robot) -> None:
    robot.chassis.call(lambda sim: setattr(sim.chassis.actions, "tick", lambda dt: None))
    goal = step(robot, 20.0)
    robot.chassis.wait_received(CALL_ACTION)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert robot.chassis.counts[FEEDBACKS] == 1, "only the query at the begin of the link"


def test_goal_ends_only_when_the_chassis_says_so(robot: Robot) -> None:
    def without_the_cancel(out: Outgoing) -> list[Outgoing]:
        state = getattr(out.body, "state", 0)
        return [out] if out.sn or (out.type, state) != (TASK_PROC, TASK_CANCELED) else []

    robot.chassis.intercept(without_the_cancel)
    goal = until(task(robot, task_id=4), EXECUTING)
    goal.cancel()
    robot.chassis.wait_received(ACTION_ORDER)
    assert not goal.done
    robot.chassis.push(proc(4, COMPLETED, "had just arrived"))
    assert goal.result()[0] == SUCCEEDED


@pytest.mark.parametrize("delay", [0.0, 0.2], ids=["after the refusal", "before the refusal"])
def test_refused_cancel_can_be_repeated(robot: Robot, delay: float) -> None:
    robot.chassis.refuse(ACTION_ORDER, "not on the lift")
    robot.chassis.delay(ACTION_ORDER, delay)
    goal = driving(robot)
    goal.cancel()
    robot.chassis.wait_received(ACTION_ORDER)
    robot.chassis.accept(ACTION_ORDER)
    assert not goal.done
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert robot.chassis.counts[ACTION_ORDER] == 2


@pytest.mark.parametrize("ok", [False, True])
@each_kind
def test_cancel_that_comes_before_the_goal_begins_is_sent_again_when_it_begins(
    robot: Robot, kind: Kind, ok: bool
) -> None:
    """The chassis may refuse it, or accept it without an effect."""
    remove = robot.chassis.intercept(without_reports)
    robot.set_goal_timing(poll_period=600.0, cancel_report_timeout=600.0)
    goal = kind.start(robot)
    wait_until(lambda: robot.agent.agent.actions.accepted_goals, "its acceptance")
    polls = robot.chassis.counts[kind.polls]
    replace_answers(robot.chassis, kind.cancels, ok=ok)
    sent = robot.chassis.counts[kind.cancels]
    goal.cancel()
    robot.chassis.wait_received(kind.cancels, sent + 1)
    wait_served(robot)
    robot.chassis.accept(kind.cancels)
    assert robot.chassis.counts[kind.cancels] == sent + 1
    assert robot.chassis.counts[kind.polls] == polls, "a poll may find the end of an earlier goal"
    remove()
    robot.chassis.push(kind.report(kind.runs, "begins"))
    assert goal.result()[0] == CANCELED
    assert robot.chassis.counts[kind.cancels] == sent + 2


@pytest.mark.parametrize("begins", [True, False])
def test_an_earlier_cancel_that_the_chassis_repeats_ends_no_cancelled_goal(
    robot: Robot, begins: bool
) -> None:
    """The list that it pushes holds the last states of all actions, so also of an ended one."""
    robot.chassis.refuse(FEEDBACKS, "unknown request")  # no poll helps
    earlier = until(step(robot, 20.0), ACTION.runs)
    earlier.cancel()
    assert earlier.result()[0] == CANCELED
    robot.chassis.call(lambda sim: setattr(sim.chassis.actions, "tick", lambda dt: None))
    goal = step(robot, 20.0)
    wait_until(lambda: robot.agent.agent.actions.accepted_goals, "its acceptance")
    if begins:
        replace_answers(robot.chassis, CALL_ACTION, ok=True)
    goal.cancel()
    robot.chassis.wait_received(CALL_ACTION, 4)
    last = earlier.feedback.messages[-1]
    old = Feedback(action=STEP, state=last.state.value, code=last.code, msg=last.msg)
    robot.chassis.push(Feedbacks(fbs=[old, Feedback(action="woosh.ros.action.LiftControl")]))
    wait_served(robot)
    if begins:
        assert not goal.done
        robot.chassis.accept(CALL_ACTION)
        robot.chassis.push(ACTION.report(ACTION.runs, "begins"))
        robot.chassis.wait_received(CALL_ACTION, 5)
        robot.chassis.push(Feedbacks(fbs=[old]))
    assert goal.result(timeout=5.0)[0] == CANCELED


@pytest.mark.parametrize("by_other", [False, True], ids=["own", "of another program"])
@pytest.mark.parametrize("begins", [True, False])
def test_the_cancel_of_a_replaced_action_ends_no_cancelled_goal(
    robot: Robot, begins: bool, by_other: bool
) -> None:
    """It may be reported before the chassis has begun the newer goal."""
    if not begins:
        robot.chassis.refuse(FEEDBACKS, "unknown request")  # no poll helps
    old = until(step(robot, 20.0), ACTION.runs)
    if by_other:
        old.cancel()
        assert old.result()[0] == CANCELED
        robot.chassis.push(ACTION.report(ACTION.runs, "begins"))
        wait_until(lambda: robot.agent.agent.robot.gate.owner == "StepControl")
    sent = robot.chassis.counts[CALL_ACTION]
    remove = robot.chassis.intercept(without_reports)
    robot.chassis.call(lambda sim: setattr(sim.chassis.actions, "tick", lambda dt: None))
    goal = step(robot, 10.0)
    if by_other:
        wait_until(lambda: robot.agent.agent.actions.accepted_goals, "its acceptance")
    else:
        assert old.wait_aborted().msg == REPLACED
    replace_answers(robot.chassis, CALL_ACTION, ok=True)  # it has no effect yet
    goal.cancel()
    robot.chassis.wait_received(CALL_ACTION, sent + 2)
    remove()
    robot.chassis.push(ACTION.report(-2, "replaced by StepControl"))
    wait_served(robot)
    if begins:
        assert not goal.done
        robot.chassis.accept(CALL_ACTION)
        robot.chassis.push(ACTION.report(ACTION.runs, "begins"))
        robot.chassis.wait_received(CALL_ACTION, sent + 3)
    assert goal.result(timeout=5.0)[0] == CANCELED


def test_cancel_waits_until_the_chassis_has_accepted_the_goal(robot: Robot) -> None:
    """The chassis may still execute another goal, which an early cancel would end."""
    answered = threading.Event()

    def hold(out: Outgoing) -> list[Outgoing]:
        return [out] if answered.is_set() or out.type != TASK_PROC else []

    robot.chassis.intercept(hold)
    robot.chassis.mute(EXEC_TASK)
    goal = task(robot, task_id=4)
    robot.chassis.wait_received(EXEC_TASK)
    goal.cancel()
    wait_served(robot)
    assert robot.chassis.counts[ACTION_ORDER] == 0
    answered.set()
    robot.chassis.push(proc(4, EXECUTING))  # a report on the goal proves that it was accepted
    assert goal.result()[0] == CANCELED
    assert robot.chassis.counts[ACTION_ORDER] == 1


def test_cancel_of_a_refused_goal_is_not_sent(robot: Robot) -> None:
    other = driving(robot)
    robot.chassis.refuse(EXEC_TASK, "busy")
    held = Held(robot.chassis, EXEC_TASK)
    goal = task(robot, mark="U5")
    goal.cancel()
    robot.chassis.wait_received(EXEC_TASK, 2)
    held.release()
    assert goal.result()[1].msg.startswith("busy")
    hurry(robot.chassis)
    assert other.result()[0] == SUCCEEDED
    assert robot.chassis.counts[ACTION_ORDER] == 0


@pytest.mark.parametrize("both", [False, True], ids=["old one", "both"])
def test_cancel_of_a_replaced_goal_does_not_hit_the_newer_one(robot: Robot, both: bool) -> None:
    robot.set_goal_timing(poll_period=0.5)
    old = driving(robot)
    remove = robot.chassis.intercept(without_reports)
    held = Held(robot.chassis, EXEC_TASK)
    new = task(robot, mark="U5")
    robot.chassis.wait_received(EXEC_TASK, 2)
    if both:
        assert len(cancel_everything(robot, "robot/ExecTask").goals_canceling) == 2
    else:
        old.cancel()
    held.release()
    old.wait_aborted("replaced by")  # by the answer to the newer goal, or by a poll
    remove()
    hurry(robot.chassis)
    assert new.result()[0] == (CANCELED if both else SUCCEEDED)
    # a cancel of both does not wait for the answer, and may have come before the newer goal
    assert robot.chassis.counts[ACTION_ORDER] == (2 if both else 0)


@pytest.mark.parametrize("turn", [0, 3])
def test_cancel_near_the_end_of_the_goal_gives_one_result(robot: Robot, turn: int) -> None:
    hurry(robot.chassis)
    goal = short_task(robot, 0.05)
    if turn:
        goal.feedback.wait_count(turn)
    goal.cancel()
    status, ret = goal.result()
    ends = {SUCCEEDED: COMPLETED, CANCELED: TASK_CANCELED}
    assert ret.state.value == ends[status]
    assert short_task(robot, 0.1).result()[0] == SUCCEEDED, (
        "the first goal must not affect the next one"
    )


def test_cancel_of_a_displaced_task_does_not_hit_the_task_of_another_client(robot: Robot) -> None:
    """The end of the first task was not reported, or is reported later."""
    goal = until(task(robot, task_id=4), EXECUTING)
    robot.chassis.mute(TASK_PROC)  # the agent polls
    reports = robot.echo(TaskProc, "robot/TaskProc")
    robot.chassis.push(proc(9, EXECUTING))
    reports.wait(lambda report: report.robot_task_id == 9)
    goal.cancel()
    wait_served(robot)
    assert robot.chassis.counts[ACTION_ORDER] == 0
    robot.chassis.push(proc(4, EXECUTING, "again"))  # the cancel is not lost
    assert goal.result()[0] == CANCELED
    assert robot.chassis.counts[ACTION_ORDER] == 1


@each_kind
def test_cancel_without_a_link_is_sent_once_when_it_is_back(robot: Robot, kind: Kind) -> None:
    goal = kind.running(robot)
    sent = robot.chassis.counts[kind.cancels]
    robot.chassis.stop_listening()
    wait_until(lambda: robot.chassis.connections == 0)
    goal.cancel()
    robot.chassis.listen()
    assert goal.result()[0] == CANCELED
    assert robot.chassis.counts[kind.cancels] == sent + 1


def test_refused_cancel_is_not_sent_again_after_a_lost_link(robot: Robot, logs: Logs) -> None:
    """A refusal is an answer, so only the client may repeat the cancel."""
    goal = driving(robot)
    robot.chassis.refuse(ACTION_ORDER, "later")
    goal.cancel()
    logs.wait_text("refused to cancel")
    told = logs.with_text(": later")
    assert [each.name for each in told] == ["woosh_robot_agent.ros.actions.giving_up"], "once"
    connected = robot.chassis.counts["woosh.robot.RobotInfo"]
    robot.chassis.drop()
    robot.chassis.wait_received("woosh.robot.RobotInfo", connected + 1)
    hurry(robot.chassis)
    assert goal.result()[0] == SUCCEEDED
    assert robot.chassis.counts[ACTION_ORDER] == 1


def test_all_goals_of_an_action_can_be_cancelled_at_once(robot: Robot) -> None:
    goal = driving(robot)
    assert len(cancel_everything(robot, "robot/ExecTask").goals_canceling) == 1
    assert goal.result()[0] == CANCELED
    assert not cancel_everything(robot, "robot/ExecTask").goals_canceling
    assert robot.chassis.counts[ACTION_ORDER] == 1
    goals = [until(each, ACTION.runs) for each in (step(robot, 20.0), lift(robot))]
    goals.append(until(lift3(robot, 0.4), ACTION.runs))
    for name in ACTIONS:
        cancel_everything(robot, name)
    assert [goal.result()[0] for goal in goals] == [CANCELED] * 3
    assert robot.chassis.counts[ACTION_ORDER] == 1


def wait_served(client: Client) -> None:
    """Call a service; its answer shows that the agent has handled everything sent earlier."""
    client.call(RobotState, "robot/RobotState")


def test_a_refused_cancel_finds_an_action_that_has_ended(robot: Robot) -> None:
    """Its end was its only report, which might have been the end of another program's action."""
    robot.chassis.intercept(without_reports)
    goal = step(robot, 20.0)
    robot.chassis.wait_received(CALL_ACTION)
    robot.chassis.call(lambda sim: sim.chassis.actions.cancel(STEP))
    goal.cancel()
    assert goal.result(timeout=3.0)[0] == CANCELED
