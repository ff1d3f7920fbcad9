"""Tasks of the real robot, the same tasks in the simulator, and the figures about both."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from tests.fact_files import facts
from tests.simulator.recorded_chassis import Frame, SteppedChassis, wait_frame
from tests.simulator.sim_wire import Json
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.pb.util import action_pb2, navigation_pb2, task_pb2

EXEC_TASK, EXEC_PRE_TASK = "woosh.robot.ExecTask", "woosh.robot.ExecPreTask"
ORDER, TASK_PROC, STATE = (
    "woosh.robot.ActionOrder",
    "woosh.robot.TaskProc",
    "woosh.robot.RobotState",
)
PAUSE, CONTINUE, CANCEL = action_pb2.kPause, action_pb2.kContinue, action_pb2.kCancel
IN_A_PILLAR = {"x": 0.0, "y": -4.0}
TASK_ID = 1719960031290
SET_ID = 1719960031

Triple = tuple[str, str, str]
"""Names of task state, action type and action state."""


class Report(NamedTuple):
    """A TaskProc about a task.

    Attributes:
        time: time since the answer to the request, in seconds.
        triple: names of task state, action type and action state.
        body: the whole report.
    """

    time: float
    triple: Triple
    body: Json


def real_robot() -> Any:
    return facts("real_robot.yaml")


def task_id(body: Json) -> int:
    """Return the id in a TaskProc, 0 for none."""
    return int(body.get("robotTaskId", 0))


def triple(body: Json) -> Triple:
    """Return task state, action type and action state of a TaskProc."""
    action = body.get("action", {})
    return (
        task_pb2.State.Name(body.get("state", 0)),
        action_pb2.Type.Name(action.get("type", 0)),
        action_pb2.State.Name(action.get("state", 0)),
    )


def ended(body: Json) -> bool:
    """Return True if a TaskProc reports the end of its task."""
    ends = (task_pb2.kCompleted, task_pb2.kCanceled, task_pb2.kFailed)
    return body.get("state", 0) in ends


class RealTask(NamedTuple):
    """A task as its client saw it.

    Attributes:
        reports: the reports about the task.
        others: the other frames until some seconds after its end, their times since the answer.
    """

    reports: list[Report]
    others: list[Frame]

    @property
    def triples(self) -> list[Triple]:
        """Task state, action type and action state of each report."""
        return [report.triple for report in self.reports]

    def first(self, wanted: Callable[[Frame], Any]) -> float:
        """Return the time of the first of the other frames that is `wanted`."""
        return next(frame.time for frame in self.others if wanted(frame))


def is_empty(frame: Frame) -> bool:
    """Return True for a TaskProc without a task."""
    return frame.type == TASK_PROC and not task_id(frame.body)


def shows(state: int) -> Callable[[Frame], bool]:
    """Return a function that is true for a RobotState with this state."""
    return lambda frame: frame.type == STATE and frame.body["state"] == state


def watch(
    chassis: SteppedChassis,
    request: Callable[[], int],
    number: int = TASK_ID,
    meanwhile: Callable[[], object] = lambda: None,
) -> RealTask:
    """Make a request that starts a task, wait for the end of the task and return what was seen.

    Args:
        chassis: the chassis.
        request: makes the request, and returns its serial number.
        number: id of the task.
        meanwhile: is called after the request.
    """
    start = len(chassis.frames)
    sn = request()
    meanwhile()
    wait_frame(
        chassis,
        lambda frame: (
            frame.type == TASK_PROC and task_id(frame.body) == number and ended(frame.body)
        ),
        after=start,
    )
    chassis.run(2.0)
    frames = chassis.frames[start:]
    answered = next(frame.time for frame in frames if frame.sn == sn)
    reports, others = [], []
    for frame in frames:
        if frame.type == TASK_PROC and not frame.sn and task_id(frame.body) == number:
            reports.append(Report(frame.time - answered, triple(frame.body), frame.body))
        else:
            others.append(frame._replace(time=frame.time - answered))
    return RealTask(reports, others)


def exec_task(chassis: SteppedChassis, mark: str = "K10", kind: int = task_pb2.kPick) -> int:
    """Request a task, and return the serial number."""
    return chassis.request(EXEC_TASK, taskId=str(TASK_ID), type=kind, markNo=mark)


def pick(chassis: SteppedChassis, meanwhile: Callable[[], object] = lambda: None) -> RealTask:
    """Drive to a mark. `meanwhile` is called after the request."""
    return watch(chassis, lambda: exec_task(chassis), meanwhile=meanwhile)


def order(chassis: SteppedChassis, number: int, after: float = 6.0) -> None:
    """Send an order after some seconds."""
    chassis.run(after)
    chassis.request(ORDER, order=number)


def cancelled(chassis: SteppedChassis) -> RealTask:
    """Cancel a task while the robot drives."""
    return pick(chassis, lambda: order(chassis, CANCEL))


def paused_and_cancelled(chassis: SteppedChassis) -> RealTask:
    """Pause a task, and then cancel it."""

    def pause_and_cancel() -> None:
        order(chassis, PAUSE)
        order(chassis, CANCEL)

    return pick(chassis, pause_and_cancel)


def charge(chassis: SteppedChassis) -> RealTask:
    return watch(chassis, lambda: exec_task(chassis, "C1", task_pb2.kCharge))


def from_a_dock(chassis: SteppedChassis) -> RealTask:
    """Drive to a mark from a charger."""
    charge(chassis)
    return pick(chassis)


def parking(chassis: SteppedChassis) -> RealTask:
    return watch(chassis, lambda: exec_task(chassis, "P1", task_pb2.kParking))


def two_waits(chassis: SteppedChassis) -> RealTask:
    """Perform a set of one task that waits at its mark."""
    tasks = woosh_task_pb2.RepeatTasks()
    repeat = tasks.repeat_tasks.add(times=1)
    repeat.task_set.base.id = SET_ID
    base = repeat.task_set.tasks.add().base
    base.id, base.type, base.mark_no, base.wait_time = 1, task_pb2.kPick, "K10", 3
    model = chassis.chassis
    model.scene = dataclasses.replace(model.scene, predefined=tasks)
    number = SET_ID * 100 + 1
    return watch(chassis, lambda: chassis.request(EXEC_PRE_TASK, taskSetId=SET_ID), number)


def failed(chassis: SteppedChassis) -> RealTask:
    """Drive to a place that cannot be reached."""
    body = {"taskId": str(TASK_ID), "type": task_pb2.kPick, "pose": IN_A_PILLAR}
    return watch(chassis, lambda: chassis.request(EXEC_TASK, **body))


def obstacle(chassis: SteppedChassis) -> RealTask:
    """Wait until an obstacle in the way has gone."""
    model = chassis.chassis

    def block_for_a_while() -> None:
        chassis.run(3.0)
        # Otherwise it would drive round the obstacle.
        chassis.request("woosh.robot.ChangeNavMode", navMode={"mode": navigation_pb2.kNavWait})
        assert model.ownership.navigation
        before, goal = (pose.point for pose in model.ownership.navigation.path[-2:])
        model.obstacles.put("box", (before[0] + goal[0]) / 2, (before[1] + goal[1]) / 2)
        chassis.run(20.0)
        model.obstacles.remove("box")

    return pick(chassis, block_for_a_while)


SCENARIOS: dict[str, Callable[[SteppedChassis], RealTask]] = {
    "pick": pick,
    "cancelled": cancelled,
    "paused and cancelled": paused_and_cancelled,
    "from a dock": from_a_dock,
    "parking": parking,
    "two waits": two_waits,
    "failed": failed,
    "obstacle": obstacle,
    "charge": charge,
}
"""Functions that make the simulator perform each of the real robot's sequences, by name."""


def matches(found: Iterable[Triple], wanted: Sequence[Any]) -> bool:
    """Return True if reports are those of a sequence, which may end in `...`."""
    triples = list(found)
    if wanted[-1] == "...":
        wanted = wanted[:-1]
        triples = triples[: len(wanted)]
    return triples == [tuple(each) for each in wanted]
