"""Helpers for the tests of the actions: goals, states, and the speed of the simulator."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from google.protobuf.message import Message

from tests.harness import Client, GoalClient, fill
from tests.quick_chassis import set_speed
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_msgs.action import ExecPreTask, ExecTask
from woosh_robot_msgs.msg import ExecTask as ExecTaskMsg
from woosh_ros_msgs.action import LiftControl, LiftControl3, MoveBase, StepControl
from woosh_ros_msgs.msg import StepControlStep

SUCCEEDED = GoalStatus.STATUS_SUCCEEDED
ABORTED = GoalStatus.STATUS_ABORTED
CANCELED = GoalStatus.STATUS_CANCELED

CANCEL, EXECUTE, PAUSE, RESUME = range(4)
EXECUTING, PAUSED, COMPLETED, TASK_CANCELED, FAILED = 3, 4, 7, 8, 9
STEP = "woosh.ros.action.StepControl"

EXEC_TASK = "woosh.robot.ExecTask"
ACTION_ORDER = "woosh.robot.ActionOrder"
CALL_ACTION = "woosh.ros.CallAction"
TASK_PROC = "woosh.robot.TaskProc"
FEEDBACKS = "woosh.ros.Feedbacks"


START = (4.23, -6.67, -0.26)
"""Initial pose of the simulated robot: x, y and theta."""


def task(client: Client, mark: str = "A2", task_id: int = 0) -> GoalClient:
    """Start a task that drives to a mark."""
    goal = fill(ExecTask.Goal(), arg={"mark_no": mark, "type": 1, "task_id": task_id})
    return client.send_goal(ExecTask, "robot/ExecTask", goal)


def task_set(client: Client, number: int) -> GoalClient:
    """Start a set of tasks."""
    goal = fill(ExecPreTask.Goal(), arg={"task_set_id": number})
    return client.send_goal(ExecPreTask, "robot/ExecPreTask", goal)


def in_front(ahead: float) -> dict[str, float]:
    """Return the fields of a pose `ahead` m in front of `START`."""
    x, y, theta = START
    return {"x": x + ahead * math.cos(theta), "y": y + ahead * math.sin(theta), "theta": theta}


def short_task_goal(ahead: float, task_id: int = 0) -> Any:
    pose = {"pose": in_front(ahead), "has_field": ExecTaskMsg.POSE_FIELD_SET}
    return fill(ExecTask.Goal(), arg={"task_id": task_id, "type": 1, **pose})


def short_task(client: Client, ahead: float, task_id: int = 0) -> GoalClient:
    """Start a task that drives to a place `ahead` m in front of `START`."""
    return client.send_goal(ExecTask, "robot/ExecTask", short_task_goal(ahead, task_id))


def step_goal(value: float, action: int = EXECUTE) -> Any:
    steps = [fill(StepControlStep(), mode=2, value=value, speed=0.5)] if value else []
    return fill(StepControl.Goal(), arg={"action": action, "steps": steps})


def step(client: Client, value: float = 0.0, action: int = EXECUTE) -> GoalClient:
    """Start a turn by `value` rad at 0.5 rad/s, which no obstacle blocks, or send another order."""
    return client.send_goal(StepControl, "ros/StepControl", step_goal(value, action))


def lift_goal(mode: int, action: int = EXECUTE) -> Any:
    return fill(LiftControl.Goal(), arg={"action": action, "execute_mode": mode})


def lift(client: Client, mode: int = 1, action: int = EXECUTE) -> GoalClient:
    return client.send_goal(LiftControl, "ros/LiftControl", lift_goal(mode, action))


def lift3(client: Client, height: float, speed: float = 0.0, action: int = EXECUTE) -> GoalClient:
    command = {"action": action, "execute_mode": 1, "height": height, "speed": speed}
    goal = fill(LiftControl3.Goal(), arg=command)
    return client.send_goal(LiftControl3, "ros/LiftControl3", goal)


def move_base(client: Client, ahead: float, action: int = EXECUTE) -> GoalClient:
    """Start a drive to a place `ahead` m in front of `START`, or send another order."""
    goal = fill(MoveBase.Goal(), arg={"target_pose": in_front(ahead), "action": action})
    return client.send_goal(MoveBase, "ros/MoveBase", goal)


def proc(task_id: int, state: int, msg: str = "") -> TaskProc:
    return TaskProc(robot_task_id=task_id, state=state, msg=msg, time=1)


def feedbacks(state: int, msg: str = "", action: str = STEP) -> Feedbacks:
    return Feedbacks(fbs=[Feedback(action=action, state=state, msg=msg)])


@dataclass(frozen=True)
class Kind:
    """A kind of goal: a task, or an action that CallAction starts.

    Attributes:
        name: its name.
        starts: type of the request that starts a goal.
        cancels: type of the request that cancels it.
        polls: type of the poll for its state, and of the reports on it.
        runs: state in a report that it runs.
        done: state in a report that it has succeeded.
        failed: state in a report that it has failed.
        start: sends a goal that takes long.
        report: returns a report on that goal, with a state and a text.
    """

    name: str
    starts: str
    cancels: str
    polls: str
    runs: int
    done: int
    failed: int
    start: Callable[[Client], GoalClient]
    report: Callable[[int, str], Message]

    def running(self, client: Client) -> GoalClient:
        """Send a goal that takes long, and wait until it runs."""
        return until(self.start(client), self.runs)


TASK = Kind(
    *("task", EXEC_TASK, ACTION_ORDER, TASK_PROC, EXECUTING, COMPLETED, FAILED),
    start=lambda client: task(client, mark="A23", task_id=11),
    report=lambda state, msg: proc(11, state, msg),
)
ACTION = Kind(
    *("action", CALL_ACTION, CALL_ACTION, FEEDBACKS, 2, 1, -1),
    start=lambda client: step(client, 100.0),
    report=feedbacks,
)
each_kind = pytest.mark.parametrize("kind", [TASK, ACTION], ids=lambda kind: kind.name)


def until(goal: GoalClient, state: int) -> GoalClient:
    """Wait until a goal has reported a state; return it."""
    goal.feedback.wait(lambda fb: fb.state.value == state)
    return goal


def without_reports(out: Outgoing) -> list[Outgoing]:
    """Drop the reports on goals that the chassis pushes; a filter for `intercept`."""
    return [] if out.type in (TASK_PROC, FEEDBACKS) and not out.sn else [out]


def slow_down(simulator: SimulatorThread) -> None:
    """Simulate in real time, so that a goal still runs during the next step of a test."""
    set_speed(simulator, 1.0)


def stop_time(simulator: SimulatorThread) -> None:
    """Almost stop simulated time, so that no goal ends: a second takes a quarter of an hour."""
    set_speed(simulator, 0.001)


def pause_task(simulator: SimulatorThread) -> None:
    """Pause the task of the chassis, as if it waited for something."""
    simulator.call(lambda sim: sim.chassis.tasks.pause("waits"))


def hurry(simulator: SimulatorThread) -> None:
    """Simulate at 50 times real time, so that goals end soon."""
    set_speed(simulator, 50.0)


class Held:
    """Answers to requests of one type, held back until `release`."""

    def __init__(self, simulator: SimulatorThread, request: str) -> None:
        self._simulator = simulator
        self._request = request
        self._answers: list[Outgoing] = []
        self._remove = simulator.intercept(self._hold)

    def _hold(self, out: Outgoing) -> Iterable[Outgoing]:
        if out.request != self._request:
            return [out]
        self._answers.append(out)
        return []

    def release(self) -> None:
        """Send the answers held back, and stop holding back."""
        self._remove()
        for out in self._answers:
            frame = JsonCodec().encode(out.type, out.body, sn=out.sn, ok=out.ok, msg=out.msg)
            self._simulator.send_raw(frame)


def replace_answers(simulator: SimulatorThread, request: str, **changes: object) -> None:
    """Replace fields of the answers to requests of a type, which the chassis does not execute."""
    simulator.refuse(request, "replaced")
    simulator.intercept(
        lambda out: [replace(out, **changes) if out.request == request else out]  # type: ignore[arg-type]
    )


def answer_with_json(chassis: SimulatorThread, request: str, **fields: Any) -> None:
    """Answer each request of a type with a frame of these fields, which need not be valid."""
    simulator = chassis.call(lambda running: running)

    def answer(frame: Any) -> list[Any]:
        if frame.request != request:
            return [frame]
        simulator.send_raw(
            json.dumps({"type": request, "sn": frame.sn, "ok": True, "body": {}, **fields})
        )
        return []

    chassis.intercept(answer)
