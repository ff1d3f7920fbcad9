"""Obstacles in the way of tasks, actions and steps: reported, waited for, avoided."""

from __future__ import annotations

import math

import pytest

from tests.simulator.recorded_chassis import SteppedClient
from tests.simulator.sim_wire import Json

PROC, OPERATION = "woosh.robot.TaskProc", "woosh.robot.OperationState"
ABNORMAL, CODE = "woosh.robot.count.AbnormalCodes", "woosh.robot.count.StatusCode"
CALL, FEEDBACKS = "woosh.ros.CallAction", "woosh.ros.Feedbacks"
EXECUTING, COMPLETED, FAILED = 3, 7, 9
ACTION_EXECUTING, ACTION_WARNING = 1, 2
AVOID, WAIT, TIMEOUT, OVERTIME, NARROW = 1, 2, 3, 4, 10
IMPEDE = 8
AVOIDED = "130104000031"
GOAL = {"type": 1, "pose": {"x": 9.0, "y": 0.0}}


@pytest.fixture
def client() -> SteppedClient:
    return SteppedClient()


@pytest.fixture(autouse=True)
def _obstacle_ahead(client: SteppedClient) -> None:
    client.ask("woosh.robot.InitRobot", {"pose": {"x": 0.0, "y": 0.0}})
    put(client, 6.0)
    client.subscribe(PROC, OPERATION, ABNORMAL, CODE, FEEDBACKS)


def put(client: SteppedClient, x: float, radius: float = 0.3, y: float = 0.0) -> None:
    client.chassis.obstacles.put("box", x, y, radius)


def remove(client: SteppedClient) -> None:
    client.chassis.obstacles.remove("box")


def start_task(client: SteppedClient, mode: int, timeout: int = 0) -> None:
    """Start a task with a goal beyond the obstacle, in the given navigation mode."""
    client.ask("woosh.robot.ExecTask", GOAL)
    setting = {"type": 2, "mode": mode, "waitTimeout": timeout}
    client.ask("woosh.robot.ChangeNavMode", {"navMode": setting})


def warns(proc: Json) -> bool:
    return bool(proc.get("action", {}).get("state") == ACTION_WARNING)


def next_impeded_report(client: SteppedClient) -> Json:
    """Return the next report of an impeded task, and check that the other states agree."""
    report = client.next_push(PROC, warns)
    assert report["state"] == EXECUTING
    assert "an obstacle stands in the way" in report["msg"]
    assert client.next_push(OPERATION, lambda body: body["nav"] == IMPEDE)["robot"] == 1
    (code,) = client.next_push(ABNORMAL)["scs"]
    assert (code["level"], code["msg"]) == (1, "something blocks the way ahead")
    return report


def end_of_task(client: SteppedClient) -> Json:
    return client.next_push(PROC, lambda body: body["state"] in (COMPLETED, FAILED))


def test_task_avoids_an_obstacle(client: SteppedClient) -> None:
    client.subscribe("woosh.robot.PoseSpeed", "woosh.robot.NavPath")
    client.ask("woosh.robot.ExecTask", GOAL)  # avoidance is the default mode
    nearest, corners, warnings, states, codes = math.inf, 0, 0, [], []
    while True:
        frame = client.receive()
        kind, body = frame["type"], frame["body"]
        if kind == "woosh.robot.PoseSpeed":
            pose = body["pose"]
            nearest = min(nearest, math.dist((6.0, 0.0), (pose["x"], pose["y"])) - 0.3)
        elif kind == "woosh.robot.NavPath":
            corners = max(corners, len(body["path"]["poses"]))
        elif kind == OPERATION:
            states.append(body["nav"])
        elif kind == CODE:
            codes.append(body["code"])
        elif kind == PROC and warns(body):
            warnings += 1
        elif kind == PROC and body["state"] in (COMPLETED, FAILED):
            break
    assert body["state"] == COMPLETED
    assert 0.4 < nearest < 1.0
    assert corners > 2
    assert warnings == 1
    assert [state for state in states if state] == [IMPEDE]
    assert codes.count(AVOIDED) == 1
    assert client.ask(OPERATION)["nav"] == 0
    assert client.ask(ABNORMAL)["scs"] == []
    assert client.chassis.pose.distance((9.0, 0.0)) < 0.01


def test_task_waits_until_the_obstacle_is_removed(client: SteppedClient) -> None:
    start_task(client, NARROW)
    next_impeded_report(client)
    client.run(5.0)
    where = client.chassis.pose
    assert 0.5 < 6.0 - where.x - 0.3 < 1.0
    client.run(60.0)
    assert client.chassis.pose == where
    assert client.ask(OPERATION)["nav"] == IMPEDE
    assert client.take_pushes(PROC) == []
    remove(client)
    going = client.next_push(PROC)
    assert (going["state"], going["action"]["state"]) == (EXECUTING, ACTION_EXECUTING)
    assert client.next_push(OPERATION)["nav"] == 0
    assert client.next_push(ABNORMAL)["scs"] == []
    assert end_of_task(client)["state"] == COMPLETED


def test_task_replans_after_the_wait_timeout(client: SteppedClient) -> None:
    start_task(client, TIMEOUT, timeout=20)
    since = next_impeded_report(client)["time"]
    avoided = client.next_push(CODE, lambda body: body["code"] == AVOIDED)
    assert 19.0 <= int(avoided["time"]) / 1000 - since <= 22.0
    assert end_of_task(client)["state"] == COMPLETED


def test_task_fails_after_the_wait_timeout(client: SteppedClient) -> None:
    start_task(client, OVERTIME, timeout=10)
    since = next_impeded_report(client)["time"]
    failed = end_of_task(client)
    assert failed["state"] == FAILED
    assert "remove it or choose another goal" in failed["msg"]
    assert 9 <= failed["time"] - since <= 12
    assert client.ask(OPERATION)["nav"] == 0
    # Once the way is free, the task can be recovered where it failed.
    remove(client)
    client.ask("woosh.robot.ActionOrder", {"order": 5})
    assert client.next_push(PROC)["state"] == EXECUTING
    assert end_of_task(client)["state"] == COMPLETED


def test_task_waits_then_fails_if_there_is_no_way_round(client: SteppedClient) -> None:
    put(client, 9.0, 0.6)  # on the goal itself
    start_task(client, AVOID)
    next_impeded_report(client)
    failed = end_of_task(client)
    assert failed["state"] == FAILED
    assert "an obstacle stands in the way" in failed["msg"]


def test_task_set_continues_after_its_failed_task_recovers(client: SteppedClient) -> None:
    put(client, -2.0, 0.6, y=6.0)  # on A1
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 666})
    assert end_of_task(client)["state"] == FAILED
    client.run(20.0)
    assert client.take_pushes(PROC) == []
    remove(client)
    client.ask("woosh.robot.ActionOrder", {"order": 5})
    ends = [end_of_task(client) for _ in range(2)]
    assert [(each["robotTaskId"], each["state"]) for each in ends] == [
        ("66601", COMPLETED),
        ("66602", COMPLETED),
    ]


def test_waiting_task_avoids_the_obstacle_after_a_mode_change(client: SteppedClient) -> None:
    start_task(client, WAIT)
    next_impeded_report(client)
    client.ask("woosh.robot.ChangeNavMode", {"navMode": {"type": 2, "mode": AVOID}})
    assert client.next_push(CODE, lambda body: body["code"] == AVOIDED)
    assert end_of_task(client)["state"] == COMPLETED


def test_task_never_leaves_a_strict_path(client: SteppedClient) -> None:
    segment = {"path": {"poses": [{"x": 9.0, "y": 0.0}]}, "optimal": 9}
    client.ask("woosh.robot.ExecTask", {"type": 1, "planPath": {"planPath": [segment]}})
    next_impeded_report(client)
    assert end_of_task(client)["state"] == FAILED
    assert abs(client.chassis.pose.y) < 0.01


def test_paused_task_is_not_impeded(client: SteppedClient) -> None:
    start_task(client, WAIT)
    next_impeded_report(client)
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    assert client.next_push(OPERATION)["nav"] == 0
    assert client.next_push(ABNORMAL)["scs"] == []
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    next_impeded_report(client)
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    assert client.next_push(OPERATION)["nav"] == 0


def test_move_base_reports_an_obstacle_in_the_way(client: SteppedClient) -> None:
    client.ask(CALL, {"moveBase": {"action": 1, "targetPose": {"x": 9.0}}})
    client.ask(CALL, {"navMode": {"mode": WAIT}})
    action = "woosh.ros.action.NavigationMode"
    for state in (2, 1):  # executes, succeeds
        mode = client.next_push(FEEDBACKS, lambda body: body["fbs"][0]["action"] == action)
        assert mode["fbs"][0]["state"] == state
    (report,) = client.next_push(FEEDBACKS, lambda body: body["fbs"][0]["state"] == 10)["fbs"]
    assert "an obstacle stands in the way" in report["msg"]
    assert client.next_push(OPERATION)["nav"] == IMPEDE
    client.run(20.0)
    assert client.ask(OPERATION)["nav"] == IMPEDE  # it waits, as the mode says
    remove(client)
    assert client.next_push(OPERATION)["nav"] == 0
    assert client.next_push(FEEDBACKS, lambda body: body["fbs"][0]["state"] == 1)


STEPS: list[tuple[Json, tuple[float, float]]] = [
    ({"mode": 1, "value": 2.0}, (1.7, 0.0)),
    ({"mode": 1, "value": -2.0}, (-1.7, 0.0)),
    ({"mode": 3, "value": 2.0}, (0.0, 1.7)),
    ({"mode": 4, "value": 2.0, "angle": math.pi / 4}, (1.2, 1.2)),
]
"""Steps, and places of obstacles in their way."""


def test_step_stops_before_an_obstacle(client: SteppedClient) -> None:
    for step, place in STEPS:
        client.ask("woosh.robot.InitRobot", {"pose": {"x": 0.0, "y": 0.0}})
        put(client, place[0], y=place[1])
        client.pushes.clear()
        client.ask(CALL, {"stepControl": {"action": 1, "steps": [step]}})
        assert client.next_push(OPERATION)["nav"] == IMPEDE
        (end,) = client.next_push(FEEDBACKS, lambda body: body["fbs"][0]["state"] == -1)["fbs"]
        assert "obstacle" in end["msg"]
        assert client.next_push(OPERATION)["nav"] == 0
        # It stopped before contact.
        assert 0.5 < client.chassis.pose.distance(place) - 0.3 < 1.1
        remove(client)
        client.ask(CALL, {"stepControl": {"action": 1, "steps": [step]}})
        assert client.next_push(FEEDBACKS, lambda body: body["fbs"][0]["state"] == 1)


def test_step_without_avoidance_drives_until_contact(client: SteppedClient) -> None:
    put(client, 2.0)
    step = {"mode": 1, "value": 3.0}
    client.ask(CALL, {"stepControl": {"action": 1, "steps": [step], "avoid": 1}})
    assert client.next_push(FEEDBACKS, lambda body: body["fbs"][0]["state"] == -1)
    assert 0.39 < 2.0 - 0.3 - client.chassis.pose.x < 0.45  # its front is 0.4 m ahead
