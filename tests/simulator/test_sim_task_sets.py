"""Predefined task sets: run, added, replaced and deleted by ExecPreTask and RepeatTask."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
from google.protobuf import json_format
from google.protobuf.message import Message

from tests.simulator.recorded_chassis import SteppedClient
from tests.simulator.sim_wire import Json
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.task.woosh_task_pb2 import TaskInfo
from woosh_robot_agent.simulator import SimulatorConfig
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.profile import load_profile
from woosh_robot_agent.simulator.protocol.handlers import Answer, dispatch

REPEAT, PRE_TASK = "woosh.task.RepeatTask", "woosh.robot.ExecPreTask"
EXEC_TASK, ORDER = "woosh.robot.ExecTask", "woosh.robot.ActionOrder"
PROC = "woosh.robot.TaskProc"
PUT, DELETE, EXECUTE = 1, 2, 3
ACTION_WAIT, COMPLETED, CANCELED, FAILED = 5, 7, 8, 9
ENDED = (COMPLETED, CANCELED, FAILED)
CHARGE = 3
PAUSE, CONTINUE, CANCEL = 2, 3, 4


def task_set(number: int, *marks: str, **base: Any) -> Json:
    tasks = [{"base": {"markNo": mark, "type": 1}} for mark in marks]
    return {"base": {"id": number, **base}, "tasks": tasks}


def put(number: int, *marks: str, times: int = 0) -> Json:
    return {"order": PUT, "times": times, "taskSet": task_set(number, *marks)}


def listed(client: SteppedClient) -> dict[int, Json]:
    sets = client.ask("woosh.task.RepeatTasks")["repeatTasks"]
    return {each["taskSet"]["base"]["id"]: each for each in sets}


def ended(client: SteppedClient, count: int) -> list[tuple[str, int]]:
    """Return the ids and states of the tasks that end next."""
    bodies = [client.next_push(PROC, lambda body: body["state"] in ENDED) for _ in range(count)]
    return [(body["robotTaskId"], body["state"]) for body in bodies]


@pytest.fixture
def client() -> SteppedClient:
    return SteppedClient()


def test_added_task_set_is_kept_and_can_be_run(client: SteppedClient) -> None:
    client.subscribe(PROC)
    answer = client.request(REPEAT, put(9, "A2", "K10", times=2) | {"addr": 3, "key": 4})
    assert (answer["type"], answer["ok"]) == (REPEAT, True)
    kept = listed(client)[9]
    assert answer["body"] == kept
    assert (kept["order"], kept["times"], kept["addr"], kept["key"]) == (0, 2, 3, 4)
    assert [each["base"]["id"] for each in kept["taskSet"]["tasks"]] == [1, 2]
    base = kept["taskSet"]["base"]
    assert (base["no"], base["adapter"]) == ("9", "woosh")
    client.ask(PRE_TASK, {"taskSetId": 9})
    assert ended(client, 4) == [("901", COMPLETED), ("902", COMPLETED)] * 2
    assert client.take_pushes(PROC) == []


def test_task_set_gets_an_id_is_replaced_in_its_place_and_deleted(client: SteppedClient) -> None:
    first = client.ask(REPEAT, put(0, "A2"))["taskSet"]["base"]["id"]
    second = client.ask(REPEAT, put(0, "K10"))["taskSet"]["base"]["id"]
    assert len({first, second, 0}) == 3
    before = listed(client)
    assert {first, second} <= set(before)

    client.ask(REPEAT, put(666, "K10", "A2"))
    now = listed(client)
    assert list(now) == list(before)
    assert [each["base"]["markNo"] for each in now[666]["taskSet"]["tasks"]] == ["K10", "A2"]
    assert {**now, 666: None} == {**before, 666: None}

    # A set that is deleted while it runs goes on.
    client.subscribe(PROC)
    client.ask(PRE_TASK, {"taskSetId": 666})
    client.ask(REPEAT, {"order": DELETE, "taskSet": {"base": {"id": 666}}})
    assert list(listed(client)) == [number for number in before if number != 666]
    assert ended(client, 2) == [("66601", COMPLETED), ("66602", COMPLETED)]
    assert client.refusal(PRE_TASK, {"taskSetId": 666}).startswith("unknown task set 666")


RUNS: list[tuple[Json, list[str]]] = [
    ({"order": EXECUTE, "taskSet": {"base": {"id": 1735291765}}}, ["173529176501"] * 2),
    ({"order": EXECUTE, "times": 1, "taskSet": {"base": {"id": 1735291765}}}, ["173529176501"]),
    ({"order": EXECUTE, "times": 2, "taskSet": task_set(8, "K10")}, ["801", "801"]),
    ({"taskSet": task_set(8, "K10")}, ["801"]),
]
"""Bodies of RepeatTask, and the ids of the tasks that they run."""


def test_task_set_is_run_by_its_id_or_with_the_tasks_in_the_request(client: SteppedClient) -> None:
    client.subscribe(PROC)
    sets = listed(client)
    for body, ids in RUNS:
        client.ask(REPEAT, body)
        assert ended(client, len(ids)) == [(each, COMPLETED) for each in ids]
        assert client.take_pushes(PROC) == []
        assert listed(client) == sets


BAD_TASKS: dict[str, tuple[Json, str]] = {
    "no tasks": (put(9), "the task set has 0 tasks: give 1 to 99"),
    "an unknown mark": (put(9, "A2", "Z9"), "unknown mark Z9: no map of scene wooshmap has it"),
    "a negative id": (put(-1, "A2"), "task set id -1 is negative"),
    "a charge task elsewhere": (
        {"order": PUT, "taskSet": {"tasks": [{"base": {"markNo": "A2", "type": CHARGE}}]}},
        "mark A2 is not a charger",
    ),
    "an id twice": (
        {"order": PUT, "taskSet": {"tasks": [{"base": {"id": 2, "markNo": "A2"}}] * 2}},
        "task ids [2, 2] must be different",
    ),
    "an id of three digits": (
        {"order": PUT, "taskSet": {"tasks": [{"base": {"id": 100, "markNo": "A2"}}]}},
        "task ids [100] must be",
    ),
    "too many repetitions": (put(9, "A2", times=101), "101 repetitions are not within 0 to 100"),
    "too long names": (
        {"order": PUT, "taskSet": task_set(9, "A2", name="n" * 70_000)},
        "the task set has more than 65536 bytes",
    ),
    "an unknown order": ({"order": 4}, "unknown order 4: 1 is put"),
    "deletion of an unknown set": ({"order": DELETE}, "unknown task set 0"),
    "execution of nothing": ({}, "unknown task set 0"),
    "execution of bad tasks": (
        {"order": EXECUTE, "taskSet": task_set(8, "Z9")},
        "unknown mark Z9",
    ),
}


def test_invalid_task_set_is_refused_and_changes_nothing(client: SteppedClient) -> None:
    before = listed(client)
    for what, (body, reason) in BAD_TASKS.items():
        assert client.refusal(REPEAT, body).startswith(reason), what
        assert listed(client) == before, what
        assert client.ask("woosh.robot.RobotState")["state"] == 2, what


def test_number_of_task_sets_is_limited(client: SteppedClient) -> None:
    for number in range(1, 201 - len(listed(client))):
        client.ask(REPEAT, put(number, "A2"))
    assert client.refusal(REPEAT, put(999, "A2")).startswith("there are already 200 task sets")
    client.ask(REPEAT, put(1, "K10"))  # replacing one is possible


def test_task_sets_belong_to_their_scene_and_their_robot(client: SteppedClient) -> None:
    client.ask(REPEAT, put(9, "A2"))
    client.ask("woosh.robot.SwitchMap", {"sceneName": "scenex"})
    assert 9 not in listed(client)
    client.ask("woosh.robot.SwitchMap", {"sceneName": "wooshmap"})
    assert 9 in listed(client)
    assert 9 not in listed(SteppedClient())


def test_task_set_of_add_task_runs_once(client: SteppedClient) -> None:
    client.subscribe(PROC)
    before = listed(client)
    answer = client.request("woosh.task.AddTask", {"tset": task_set(9, "A2", "K10")})
    assert (answer["type"], answer["ok"], answer["body"]) == ("woosh.task.AddTask", True, {})
    assert ended(client, 2) == [("901", COMPLETED), ("902", COMPLETED)]
    assert listed(client) == before
    assert "has 0 tasks" in client.refusal("woosh.task.AddTask", {"tset": {"base": {"id": 666}}})
    assert "unknown mark Z" in client.refusal("woosh.task.AddTask", {"tset": task_set(1, "Z")})
    client.ask("woosh.robot.SwitchControlMode", {"mode": 2})
    reason = client.refusal("woosh.task.AddTask", {"tset": task_set(9, "A2")})
    assert "manual mode" in reason


def test_robot_that_is_not_ready_says_so_before_anything_else(client: SteppedClient) -> None:
    client.chassis.set_emergency_stop(True)
    reason = "emergency stop is pressed: release it first"
    assert client.refusal(EXEC_TASK, {"markNo": "Z9"}) == reason
    assert client.refusal(PRE_TASK, {"taskSetId": 4}) == reason
    unknown = {"order": EXECUTE, "taskSet": {"base": {"id": 4}}}
    assert client.refusal(REPEAT, unknown) == reason


def upload_set(client: SteppedClient, repeat: Json) -> None:
    """Upload a task set in a file, as the robot's own tools write it."""
    info = json_format.ParseDict({"repeatTasks": [repeat]}, TaskInfo())
    data = base64.b64encode(info.SerializeToString()).decode()
    client.ask("woosh.map.Upload", {"fileDatas": [{"name": "task_info.data", "data": data}]})


def test_task_set_of_a_file_runs_at_least_once_and_needs_a_task(client: SteppedClient) -> None:
    upload_set(client, {"taskSet": {"base": {"id": 9}}})
    reason = "task set 9 has no tasks: put it with at least one"
    assert client.refusal(PRE_TASK, {"taskSetId": 9}) == reason
    tasks = [{"base": {"id": 1, "markNo": "K10", "type": 1}}]
    upload_set(client, {"times": -2, "taskSet": {"base": {"id": 9}, "tasks": tasks}})
    client.ask(PRE_TASK, {"taskSetId": 9})
    assert client.chassis.tasks.proc.robot_task_id == 901


def test_setting_the_navigation_mode_holds_up_no_waiting_task(client: SteppedClient) -> None:
    """The action that sets the mode needs no device, and neither does the wait of the task."""
    client.subscribe(PROC)
    client.ask(PRE_TASK, {"taskSetId": 777})
    client.next_push(PROC, lambda body: body["state"] == ACTION_WAIT)
    move = {"action": 1, "targetPose": {"x": 8.0, "y": 0.0}}
    for action in ({"moveBase": move}, {"navMode": {"mode": 3}}):
        client.ask("woosh.ros.CallAction", action)
    for order in (PAUSE, CONTINUE):
        client.ask(ORDER, {"order": order})


# With the delays of a real robot


def ask(chassis: Chassis, name: str, body: Json) -> Answer:
    chassis.begin_request(name)
    return dispatch(chassis, json_format.ParseDict(body, message_type(name)()))


@pytest.fixture
def real() -> Chassis:
    return Chassis(SimulatorConfig(seed=1))


def run_until(chassis: Chassis, condition: Callable[[], object]) -> list[robot_pb2.TaskProc]:
    """Let time pass until a condition is true, and return the reports about tasks meanwhile."""
    for _ in range(10_000):
        if condition():
            break
        chassis.tick(TIME_STEP / 10)
    else:
        raise AssertionError("the condition does not come true")
    events: list[Message] = chassis.take_events()
    return [event for event in events if isinstance(event, robot_pb2.TaskProc)]


def run_to_the_gap(chassis: Chassis, body: Json) -> None:
    """Run a task set up to the moment between its first task and its second one."""
    chassis.localise(chassis.map.marks["K10"].pose)
    assert ask(chassis, REPEAT, body).ok
    run_until(chassis, lambda: chassis.tasks.between_tasks)


TWO_TASKS = {"order": EXECUTE, "taskSet": task_set(8, "K10", "K10")}


def assert_set_ends(chassis: Chassis) -> None:
    """Check that no task follows the current one."""
    reports = run_until(chassis, lambda: not chassis.tasks.state)
    assert reports[-1].robot_task_id == 0
    for _ in range(50):
        chassis.tick(TIME_STEP)
    assert not chassis.tasks.active
    assert not [each for each in chassis.take_events() if isinstance(each, robot_pb2.TaskProc)]


@pytest.mark.parametrize("between", [True, False])
def test_task_set_is_cancelled_during_a_task_and_between_two(between: bool) -> None:
    profile = load_profile("tr200")
    tasks = dataclasses.replace(profile.tasks, next_after_cancel=False)
    chassis = Chassis(SimulatorConfig(profile=dataclasses.replace(profile, tasks=tasks)))
    if between:
        run_to_the_gap(chassis, TWO_TASKS)
    else:
        assert ask(chassis, REPEAT, TWO_TASKS).ok
        run_until(chassis, lambda: chassis.tasks.reported.robot_task_id == 801)
    assert ask(chassis, ORDER, {"order": CANCEL}).ok
    assert_set_ends(chassis)


def test_cancel_of_a_task_ends_its_set_only_while_it_is_paused(real: Chassis) -> None:
    """As the tasks 42 and 23 of a real robot in `real_tasks.json`."""
    body = {"order": EXECUTE, "taskSet": task_set(8, "A2", "A2", "A2")}
    assert ask(real, REPEAT, body).ok
    run_until(real, lambda: real.tasks.reported.robot_task_id == 801)
    assert ask(real, ORDER, {"order": CANCEL}).ok
    run_until(real, lambda: real.tasks.between_tasks)
    assert not ask(real, ORDER, {"order": CANCEL}).ok, "there is no task"
    reports = run_until(real, lambda: real.tasks.reported.robot_task_id == 802)
    assert [each.robot_task_id for each in reports] == [0, 802]
    for number in (PAUSE, CANCEL):
        assert ask(real, ORDER, {"order": number}).ok
    assert_set_ends(real)


def test_task_set_runs_between_its_tasks_too(real: Chassis) -> None:
    run_to_the_gap(real, TWO_TASKS)
    answer = ask(real, EXEC_TASK, {"type": 1, "taskId": 6, "markNo": "A2"})
    assert (answer.ok, answer.msg) == (False, "Task is excuting,request failed")
    assert not ask(real, "woosh.robot.InitRobot", {"isRecord": True}).ok
    assert not ask(real, "woosh.robot.SwitchMap", {"sceneName": "scenex"}).ok
    run_until(real, lambda: real.tasks.proc.robot_task_id == 802)


def test_task_set_goes_on_after_charging_and_leaves_the_dock_first(real: Chassis) -> None:
    real.localise(real.map.marks["C1"].pose.moved(-0.6, 0.0, 0.0))
    charge = {"base": {"id": 1, "markNo": "C1", "type": CHARGE}}
    then = {"base": {"id": 2, "markNo": "K10", "type": 1}}
    body = {"order": EXECUTE, "taskSet": {"base": {"id": 8}, "tasks": [charge, then]}}
    assert ask(real, REPEAT, body).ok
    reports = run_until(real, lambda: real.tasks.reported.robot_task_id == 802)
    docking, leaving, driving = 3, 4, 1
    assert docking in {each.action.type for each in reports if each.robot_task_id == 801}
    assert leaving not in {each.action.type for each in reports if each.robot_task_id == 801}
    reports += run_until(real, lambda: real.tasks.reported.action.type == driving)
    kinds = [each.action.type for each in reports if each.robot_task_id == 802]
    assert kinds == [leaving, leaving, driving]
