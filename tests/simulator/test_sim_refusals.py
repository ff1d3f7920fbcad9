"""Refusals: in the words of the real robot, or explained, as the profile says."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.simulator.real_tasks import shows
from tests.simulator.recorded_chassis import SteppedChassis, answer_to, ask, wait_frame
from tests.simulator.sim_wire import Json

CALL, CODE = "woosh.ros.CallAction", "woosh.robot.count.StatusCode"
EXEC_TASK, TWIST = "woosh.robot.ExecTask", "woosh.robot.Twist"
TASK = (EXEC_TASK, {"taskId": 5, "type": 1, "markNo": "A23"})
OTHER_TASK = (EXEC_TASK, {"taskId": 6, "type": 1, "markNo": "A2"})
STEP = {"stepControl": {"action": 1, "steps": [{"mode": 1, "value": 2.0, "speed": 0.2}]}}
FAILED = "Request failed"
EXECUTING = "Task is excuting,request failed"
NOT_AUTO = "It is not auto mode,request failed"
NOT_TASK_MODE = "It is not task or dispatch mode,request failed"
NO_TWIST = "State not allow to twist"
PARKING = 3

Prepare = Callable[[SteppedChassis], object]


def emergency_stop(chassis: SteppedChassis) -> None:
    chassis.chassis.set_emergency_stop(True)


def key_switch(chassis: SteppedChassis) -> None:
    chassis.chassis.set_key_switch(True)


def lost(chassis: SteppedChassis) -> None:
    chassis.chassis.lose_localisation()


def asked(name: str, body: Json) -> Prepare:
    return lambda chassis: ask(chassis, name, **body)


task_runs, steps_run = asked(*TASK), asked(CALL, STEP)

CASES: dict[str, tuple[Prepare | None, str, Json, str, str | None]] = {
    "task at emergency stop": (emergency_stop, *TASK, FAILED, None),
    "velocity at emergency stop": (
        emergency_stop, TWIST, {"linear": 0.2}, NO_TWIST, "140801000091",
    ),
    "task with the key at manual": (key_switch, *TASK, NOT_AUTO, "140801000081"),
    "velocity with the key at manual": (
        key_switch, TWIST, {"linear": 0.2}, NOT_AUTO, "140801000081",
    ),
    "steps in manual mode": (
        asked("woosh.robot.SwitchControlMode", {"mode": 2}), CALL, STEP, NOT_AUTO, "140801000081",
    ),
    "task in deployment mode": (
        asked("woosh.robot.SwitchWorkMode", {"mode": 1}), *TASK, NOT_TASK_MODE, None,
    ),
    "task while lost": (lost, *TASK, FAILED, None),
    "task while another runs": (task_runs, *OTHER_TASK, EXECUTING, "140801000131"),
    "task set while a task runs": (
        task_runs, "woosh.robot.ExecPreTask", {"taskSetId": 666}, EXECUTING, "140801000131",
    ),
    "set to repeat while a task runs": (
        task_runs,
        "woosh.task.RepeatTask",
        {"order": 3, "taskSet": {"base": {"id": 666}}},
        EXECUTING,
        "140801000131",
    ),
    "velocity during a task": (task_runs, TWIST, {"linear": 0.2}, NO_TWIST, "140801000091"),
    "initialisation during a task": (
        task_runs, "woosh.robot.InitRobot", {"isRecord": True}, FAILED, "140801000232",
    ),
    "map change during a task": (
        task_runs, "woosh.robot.SwitchMap", {"mapName": "1F"}, FAILED, "140801000221",
    ),
    "steps during a task": (task_runs, CALL, STEP, FAILED, "120301000022"),
    "steps while steps run": (steps_run, CALL, STEP, FAILED, "120301000022"),
    "velocity while steps run": (steps_run, TWIST, {"linear": 0.2}, NO_TWIST, "140801000091"),
    "navigation mode without navigation": (
        None, "woosh.robot.ChangeNavMode", {"navMode": {"mode": 1}}, FAILED, "140801000071",
    ),
    "path without navigation": (
        None, "woosh.robot.ChangeNavPath", {}, FAILED, "140801000061",
    ),
    "unknown task set": (
        None, "woosh.robot.ExecPreTask", {"taskSetId": 4}, FAILED, "140801000141",
    ),
    "unknown mark": (None, EXEC_TASK, {"type": 1, "markNo": "Z"}, FAILED, None),
    "map in task mode": (
        None,
        "woosh.robot.BuildMap",
        {"type": 1, "sceneName": "new", "mapName": "hall"},
        FAILED,
        "140801000041",
    ),
    "point in task mode": (
        None, "woosh.robot.Deployment", {"type": 4, "mode": 1}, FAILED, "140801000101",
    ),
    "update of an unknown map": (
        asked("woosh.robot.SwitchWorkMode", {"mode": 1}),
        "woosh.robot.BuildMap",
        {"type": 2, "sceneName": "a", "mapName": "b"},
        FAILED,
        "140701000021",
    ),
    "pause without a task": (
        None, "woosh.robot.ActionOrder", {"order": 2}, FAILED, "140801000271",
    ),
    "cancel without a task": (None, "woosh.robot.ActionOrder", {"order": 4}, FAILED, None),
    "steps without a step": (
        None, CALL, {"stepControl": {"action": 1}}, "steps_size is empty", None,
    ),
    "a lift mode that does not exist": (
        None, CALL, {"liftControl": {"action": 1, "executeMode": 9}}, FAILED, None,
    ),
}  # fmt: skip


def refusal(chassis: SteppedChassis, name: str, body: Json) -> str:
    """Return the text of the answer to a request, which must not be ok."""
    sn = len(chassis.raw)
    assert answer_to(chassis, name, **body).ok is False
    return next(frame["msg"] for frame in chassis.raw[sn:] if frame.get("sn"))


@pytest.mark.parametrize(
    ("prepare", "name", "body", "words", "code"), list(CASES.values()), ids=list(CASES)
)
def test_real_robot_refuses_in_few_words_and_gives_its_reason_by_a_code(
    real: SteppedChassis, prepare: Prepare | None, name: str, body: Json, words: str, code: str
) -> None:
    if prepare:
        prepare(real)
    real.run(1.0)
    real.frames.clear()
    assert refusal(real, name, body) == words
    real.run(0.2)
    answer, *given = [frame for frame in real.frames if frame.sn or frame.type == CODE]
    assert answer.sn, "the answer comes before the code"
    assert [frame.body["code"] for frame in given] == ([code] if code else [])
    assert all(frame.time - answer.time <= 0.05 for frame in given)


def test_own_task_of_the_robot_gives_way_only_to_another_kind() -> None:
    chassis = SteppedChassis(park_after=1.0)
    wait_frame(chassis, shows(PARKING))
    parking = {"taskId": 7, "type": 2, "markNo": "P1"}
    assert refusal(chassis, EXEC_TASK, parking) == EXECUTING
    ask(chassis, EXEC_TASK, **TASK[1])


@pytest.mark.parametrize("profile", ["tr200", "instant"])
def test_zero_velocity_is_accepted_in_every_state(profile: str) -> None:
    chassis = SteppedChassis(profile=profile)
    ask(chassis, EXEC_TASK, **TASK[1])
    ask(chassis, TWIST)
    emergency_stop(chassis)
    key_switch(chassis)
    ask(chassis, TWIST)
