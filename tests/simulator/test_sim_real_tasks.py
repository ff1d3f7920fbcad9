"""Tasks as the real robot performs them: the profile tr200."""

from __future__ import annotations

from typing import Any

import pytest
from google.protobuf.json_format import ParseDict

from tests.simulator.real_tasks import (
    CANCEL,
    CONTINUE,
    EXEC_PRE_TASK,
    EXEC_TASK,
    PAUSE,
    SCENARIOS,
    STATE,
    TASK_ID,
    TASK_PROC,
    charge,
    ended,
    exec_task,
    is_empty,
    matches,
    order,
    pick,
    real_robot,
    shows,
    task_id,
    triple,
    watch,
)
from tests.simulator.recorded_chassis import (
    Frame,
    SteppedChassis,
    answer_to,
    ask,
    wait_frame,
)
from woosh_robot_agent.pb.robot import robot_pb2

UNINIT, IDLE, PARKING, TASK, WARNING, FAULT, CHARGING = 1, 2, 3, 4, 5, 6, 8
AUTO, MANUAL, MAINTAIN = 1, 2, 3
FACTS = real_robot()
TIMES = FACTS["times"]


@pytest.fixture
def chassis(real: SteppedChassis) -> SteppedChassis:
    real.run(1.0)
    return real


def within(least: float, most: float) -> Any:
    """Return a value that equals times from `least` to `most`, 20 % more or less."""
    middle = (0.8 * least + 1.2 * most) / 2
    return pytest.approx(middle, abs=1.2 * most - middle + 1e-9)


def states(frames: list[Frame]) -> list[int]:
    """Return the states of the robot in frames."""
    return [frame.body["state"] for frame in frames if frame.type == STATE]


@pytest.mark.parametrize("name", FACTS["sequences"])
def test_reports_are_those_of_the_real_robot(name: str, chassis: SteppedChassis) -> None:
    task = SCENARIOS[name](chassis)
    assert matches(task.triples, FACTS["sequences"][name]["reports"]), task.triples
    assert not any(report.body["msg"] for report in task.reports)
    times = [report.time for report in task.reports]
    if name == "two waits":
        numbers = [report.body["action"]["waitId"] for report in task.reports]
        assert numbers == [0, 0, 1, 1, 2, 2, 2]
        assert times[5] - times[4] == pytest.approx(3.0, abs=0.1)
    if name == "parking":  # it ends without a wait
        assert times[2] - times[1] <= TIMES["last action to end of task"][1]
        assert states(task.others) == [PARKING, IDLE]
    if name == "obstacle":
        assert states(task.others) == [TASK, WARNING, TASK, IDLE]


def test_first_report_and_state_of_the_robot_come_at_the_times_of_the_real_robot() -> None:
    least, most = TIMES["answer to first report"]
    first_reports, states_first = [], 0
    for seed in range(60):
        chassis = SteppedChassis(seed=seed)
        sn = exec_task(chassis)
        state = wait_frame(chassis, shows(TASK))
        answer = wait_frame(chassis, lambda frame, sn=sn: frame.sn == sn)
        states_first += chassis.frames.index(state) < chassis.frames.index(answer)
        assert -0.125 <= state.time - answer.time <= 0.01
        report = wait_frame(chassis, lambda frame: frame.type == TASK_PROC)
        first_reports.append(report.time - answer.time)
    assert all(time in (within(least, least), within(most, most)) for time in first_reports)
    assert len({round(time, 1) for time in first_reports}) == 2
    share = FACTS["state_first"][0] / FACTS["state_first"][1]
    assert states_first / 60 == pytest.approx(share, abs=0.15)


def test_times_of_a_pick(chassis: SteppedChassis) -> None:
    task = pick(chassis)
    times = [report.time for report in task.reports]
    assert times[2] - times[1] == within(*[TIMES["navigation to wait"]] * 2)
    assert times[4] - times[2] <= TIMES["wait of 0 s to end of task"][1]
    assert [report.body["action"]["waitId"] for report in task.reports] == [0, 0, 1, 1, 1]
    least, most = TIMES["end of task to empty report"]
    assert least <= task.first(is_empty) - times[4] <= most
    assert task.first(shows(IDLE)) == task.first(is_empty)


def test_empty_report_has_only_time_and_robot(chassis: SteppedChassis) -> None:
    before = ask(chassis, TASK_PROC).body
    assert before["action"] == {"type": 0, "state": 0, "waitId": 0}
    fields = ParseDict(before, robot_pb2.TaskProc()).ListFields()
    assert [field.name for field, _ in fields] == ["action", "time", "robot_id"]
    pick(chassis)
    empty = next(frame.body for frame in chassis.frames if is_empty(frame) and not frame.sn)
    message = ParseDict(empty, robot_pb2.TaskProc())
    assert message.HasField("action")
    assert not message.action.ListFields()
    message.ClearField("action")
    assert [field.name for field, _ in message.ListFields()] == ["time", "robot_id"]
    assert ask(chassis, TASK_PROC).body == empty


def test_orders_show_later(chassis: SteppedChassis) -> None:
    effect = TIMES["order to its effect"]

    def orders() -> None:
        for number in (PAUSE, CONTINUE, CANCEL):
            order(chassis, number)

    task = watch(chassis, lambda: exec_task(chassis), meanwhile=orders)
    assert [report.triple[::2] for report in task.reports] == [
        ("kExecuting", "kRosExecuting"),
        ("kPaused", "kSuspend"),
        ("kExecuting", "kRosExecuting"),
        ("kExecuting", "kRosCancel"),
        ("kCanceled", "kRosCancel"),
    ]
    for ordered, report in zip((6.0, 12.0, 18.0), task.reports[1:4], strict=True):
        assert report.time - ordered == within(effect, effect)
    assert task.reports[4].time - task.reports[3].time <= TIMES["last action to end of task"][1]


def test_paused_robot_stands_before_the_report(chassis: SteppedChassis) -> None:
    exec_task(chassis)
    chassis.run(8.0)
    assert chassis.chassis.base.velocity.speed > 0.1
    chassis.request("woosh.robot.ActionOrder", order=PAUSE)
    before = chassis.chassis.base.velocity.speed
    chassis.run(0.2)
    assert chassis.chassis.base.velocity.speed < before


def test_task_that_is_cancelled_before_its_first_report(chassis: SteppedChassis) -> None:
    task = watch(chassis, lambda: exec_task(chassis), meanwhile=lambda: order(chassis, CANCEL, 0.1))
    assert task.triples == [
        ("kExecuting", "kNav", "kRosCancel"),
        ("kCanceled", "kNav", "kRosCancel"),
    ]


def test_maintenance_fails_the_task_and_ends_the_initialisation(chassis: SteppedChassis) -> None:
    """As the tasks 10 and 76 of a real robot in `real_tasks.json`."""
    exec_task(chassis)
    chassis.run(6.0)
    start = len(chassis.frames)
    for mode in (MANUAL, MAINTAIN, MANUAL, AUTO):
        ask(chassis, "woosh.robot.SwitchControlMode", mode=mode)
        chassis.run(1.0)
    frames = chassis.frames[start:]
    assert states(frames) == [FAULT, UNINIT]
    reports = [triple(frame.body) for frame in frames if frame.type == TASK_PROC]
    assert reports == [("kPaused", "kNav", "kSuspend"), ("kFailed", "kNav", "kRosFailure")]


def test_obstacle_that_stays_does_not_fail_the_task(chassis: SteppedChassis) -> None:
    exec_task(chassis)
    goal = chassis.chassis.map.marks["K10"].pose
    chassis.chassis.obstacles.put("box", goal.x, goal.y)
    chassis.run(60.0)
    reports = [triple(frame.body) for frame in chassis.frames if frame.type == TASK_PROC]
    assert reports[-1] == ("kPaused", "kNav", "kRosWarning")
    chassis.request("woosh.robot.ActionOrder", order=CANCEL)
    chassis.run(2.0)
    reports = [triple(frame.body) for frame in chassis.frames if frame.type == TASK_PROC]
    assert reports[-3:-1] == [
        ("kPaused", "kNav", "kRosCancel"),
        ("kCanceled", "kNav", "kRosCancel"),
    ]


def test_charge_goes_on_after_the_task(chassis: SteppedChassis) -> None:
    task = charge(chassis)
    pauses = [
        after.time - before.time
        for before, after in zip(task.reports[1:-1:2], task.reports[2::2], strict=True)
    ]
    assert pauses[:-1] == [pytest.approx(0.5)] * 4
    assert states(task.others) == [TASK, CHARGING]
    assert not any(map(is_empty, task.others)), "the report of the charge stays"
    level = chassis.chassis.battery.level
    chassis.run(60.0)
    assert chassis.chassis.battery.level > level + 1.0
    assert chassis.chassis.tasks.reported.robot_task_id == TASK_ID


def test_tasks_of_a_set_are_separated_by_an_empty_report(chassis: SteppedChassis) -> None:
    start = len(chassis.frames)
    ask(chassis, EXEC_PRE_TASK, taskSetId=666)
    wait_frame(chassis, lambda frame: task_id(frame.body) == 66602 and ended(frame.body))
    chassis.run(1.0)
    frames = chassis.frames[start:]
    assert states(frames) == [TASK, IDLE, TASK, IDLE]
    ids = [task_id(frame.body) for frame in frames if frame.type == TASK_PROC]
    assert ids == [66601] * 5 + [0] + [66602] * 5 + [0]
    _, idle, again, _ = (frame.time for frame in frames if frame.type == STATE)
    assert again - idle <= 0.016
    second = next(frame.time for frame in frames if task_id(frame.body) == 66602)
    assert second - again in (within(0.5, 0.5), within(1.0, 1.0))


def test_robot_gives_its_own_tasks_its_own_ids() -> None:
    chassis = SteppedChassis(charge_after=5.0, park_after=10.0)
    chassis.chassis.battery.level = 15.0
    first = wait_frame(chassis, is_empty)
    shown = wait_frame(chassis, shows(PARKING))
    report = wait_frame(chassis, lambda frame: frame.type == TASK_PROC and task_id(frame.body))
    assert task_id(report.body) == first.body["time"] * 100 + 53
    assert triple(report.body) == ("kExecuting", "kNav", "kRosExecuting")
    assert abs(shown.time - first.time) <= 0.016
    assert report.time - first.time in (within(0.5, 0.5), within(1.0, 1.0))
    # So does a task of a client without an id.
    chassis = SteppedChassis()
    ask(chassis, EXEC_TASK, type=2, markNo="P1")
    empty = wait_frame(chassis, is_empty)
    report = wait_frame(chassis, lambda frame: frame.type == TASK_PROC and task_id(frame.body))
    assert task_id(report.body) == empty.body["time"] * 100 + 53


def test_nothing_is_pushed_about_a_refused_task(chassis: SteppedChassis) -> None:
    assert answer_to(chassis, EXEC_TASK, taskId=str(TASK_ID), type=1, markNo="nowhere").ok is False
    chassis.run(10.0)
    assert not [frame for frame in chassis.frames if frame.type in (TASK_PROC, STATE)]


def test_failed_task_can_be_recovered(chassis: SteppedChassis) -> None:
    """Its report stays, so that clients know what to recover."""
    SCENARIOS["failed"](chassis)
    assert triple(ask(chassis, TASK_PROC).body)[0] == "kFailed"
    assert ask(chassis, "woosh.robot.RobotState").body["state"] == IDLE
    ask(chassis, "woosh.robot.ActionOrder", order=5)
    chassis.run(2.0)
    reports = [triple(frame.body)[0] for frame in chassis.frames if frame.type == TASK_PROC]
    assert reports[-3:] == ["kFailed", "kExecuting", "kFailed"]
