"""Tasks, from their request to their end."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tests.simulator.recorded_chassis import SteppedClient
from tests.simulator.sim_wire import Json

PROC = "woosh.robot.TaskProc"
INIT, READY, EXECUTING, PAUSED, ACTION_WAIT = 1, 2, 3, 4, 5
COMPLETED, CANCELED, FAILED = 7, 8, 9
ENDED = (COMPLETED, CANCELED, FAILED)
CONTINUE, RECOVER = 3, 5
TASK = ("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})

Change = Callable[[SteppedClient], object]


@pytest.fixture
def client() -> SteppedClient:
    return SteppedClient()


@pytest.fixture(autouse=True)
def _subscribed(client: SteppedClient) -> None:
    client.subscribe(PROC)


def reports_until_end(client: SteppedClient) -> list[Json]:
    """Return all reports of the next task, up to its end."""
    reports = [client.next_push(PROC)]
    while reports[-1]["state"] not in ENDED:
        reports.append(client.next_push(PROC))
    return reports


def test_task_drives_to_a_mark(client: SteppedClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": "1682416646", "type": 1, "markNo": "A2"})
    reports = reports_until_end(client)
    assert [each["state"] for each in reports] == [INIT, READY, EXECUTING, COMPLETED]
    for each in reports:
        assert (each["robotTaskId"], each["type"], each["dest"]) == ("1682416646", 1, "A2")
    assert reports[2]["action"] == {"type": 1, "state": 1, "waitId": 0}
    assert reports[3]["action"] == {"type": 1, "state": 4, "waitId": 0}
    pose = client.chassis.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((5.0, 4.0, 0.0), abs=0.005)
    info = client.ask("woosh.robot.RobotInfo")
    assert info["taskProc"] == reports[-1] == client.ask(PROC)
    assert info["taskHistory"]["tes"] == [reports[-1]]
    assert info["state"] == 2
    codes = client.ask("woosh.robot.count.StatusCodes")["scs"]
    assert {"130104000000", "130104000061"} <= {code["code"] for code in codes}


def test_newer_task_replaces_the_older_one(client: SteppedClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 1, "type": 1, "markNo": "A23"})
    client.next_push(PROC, lambda body: body["state"] == EXECUTING)
    client.ask("woosh.robot.ExecTask", {"taskId": 2, "type": 1, "markNo": "A2"})
    # The end of the old task is pushed before the answer.
    (end,) = [frame["body"] for frame in client.pushes if frame["type"] == PROC]
    assert (end["robotTaskId"], end["state"]) == ("1", CANCELED)
    assert "replaced" in end["msg"]
    client.pushes.clear()
    reports = reports_until_end(client)
    assert {each["robotTaskId"] for each in reports} == {"2"}
    assert reports[-1]["state"] == COMPLETED


def test_failed_task_is_reported_and_can_be_recovered(client: SteppedClient) -> None:
    client.subscribe("woosh.robot.count.StatusCode")
    # Too close to the partition to stand there.
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "pose": {"x": -4.8, "y": -6}})
    end = client.next_push(PROC, lambda body: body["state"] in ENDED)
    assert end["state"] == FAILED
    assert "no free path" in end["msg"]
    last = client.ask("woosh.robot.count.StatusCodes")["scs"][-1]
    assert (last["code"], last["level"], last["robotTaskId"]) == ("140304000012", 2, "5")
    assert "no free path" in last["msg"]
    client.ask("woosh.robot.ActionOrder", {"order": 5})
    assert client.next_push(PROC)["state"] == EXECUTING
    assert client.next_push(PROC)["state"] == FAILED


def test_wait_ends_by_order_or_after_its_time(client: SteppedClient) -> None:
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 777})
    waiting = client.next_push(PROC, lambda body: body["state"] == ACTION_WAIT)
    assert waiting["action"] == {"type": 6, "state": 1, "waitId": 1}
    # This one has no time. It can be paused, and waits again when continued.
    client.run(60.0)
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    assert client.next_push(PROC)["state"] == PAUSED
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.next_push(PROC)["state"] == ACTION_WAIT
    # A velocity of zero does not pause it: nothing moves.
    assert client.request("woosh.robot.Twist")["ok"]
    assert client.take_pushes(PROC) == []
    client.ask("woosh.robot.ActionOrder", {"order": 6})
    assert client.next_push(PROC)["state"] == COMPLETED
    waiting = client.next_push(PROC, lambda body: body["state"] == ACTION_WAIT)
    end = client.next_push(PROC)
    assert end["state"] == COMPLETED
    assert 4 <= end["time"] - waiting["time"] <= 6


CONTROL_MODE = "woosh.robot.SwitchControlMode"
POSE = {"x": 1.0, "y": 2.0}
CONDITIONS: list[tuple[str, Change, Change, int]] = [
    (
        "emergency stop is pressed",
        lambda client: client.chassis.set_emergency_stop(True),
        lambda client: client.chassis.set_emergency_stop(False),
        CONTINUE,
    ),
    (
        "key switch is at manual",
        lambda client: client.chassis.set_key_switch(True),
        lambda client: client.chassis.set_key_switch(False),
        RECOVER,
    ),
    (
        "robot is in manual mode",
        lambda client: client.ask(CONTROL_MODE, {"mode": 2}),
        lambda client: client.ask(CONTROL_MODE, {"mode": 1}),
        CONTINUE,
    ),
    (
        "robot has lost its localisation",
        lambda client: client.chassis.lose_localisation(),
        lambda client: client.ask("woosh.robot.SetRobotPose", {"pose": POSE}),
        CONTINUE,
    ),
]
"""Conditions: the reason that is told, their begin and end, and the order that goes on."""


def test_robot_that_is_not_ready_pauses_its_task_until_an_order(client: SteppedClient) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
    client.next_push(PROC, lambda body: body["state"] == EXECUTING)
    for reason, begin, end, order in CONDITIONS:
        begin(client)
        paused = client.next_push(PROC)
        assert (paused["state"], paused["msg"]) == (PAUSED, reason)
        assert client.ask("woosh.robot.OperationState")["robot"] == 0
        for name, body in (TASK, ("woosh.robot.ActionOrder", {"order": order})):
            assert client.refusal(name, body).startswith(f"{reason}: ")
        end(client)
        assert client.ask("woosh.robot.OperationState")["robot"] == 1
        client.run(10.0)
        assert client.chassis.base.velocity.speed == 0.0
        assert client.take_pushes(PROC) == []
        client.ask("woosh.robot.ActionOrder", {"order": order})
        assert client.next_push(PROC)["state"] == EXECUTING
    assert client.next_push(PROC)["state"] == COMPLETED


def test_charge_task_without_a_mark_leads_to_the_nearest_charger(client: SteppedClient) -> None:
    storage = {
        "identity": {"no": "C2"},
        "pose": {"dock": {"x": 10.0, "y": -6.0, "theta": 0.0}},
        "charger": {},
    }
    client.ask("woosh.map.mark.storage.Create", {"storage": storage})
    client.chassis.battery.level = 97.9
    client.ask("woosh.robot.ExecTask", {"type": 3, "pose": {"x": 0, "y": 0, "theta": 0}})
    reports = reports_until_end(client)
    assert (reports[-1]["state"], reports[-1]["dest"]) == (COMPLETED, "C2")
    assert client.chassis.pose.distance((10.0, -6.0)) < 0.05
    # It leaves the charger for one that is named.
    client.ask("woosh.robot.ExecTask", {"type": 3, "markNo": "C1"})
    assert reports_until_end(client)[-1]["dest"] == "C1"
    assert client.chassis.pose.distance((-10.8, 0.5)) < 0.05


def test_carry_task_lifts(client: SteppedClient) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 4, "direction": 1, "markNo": "K10"})
    reports = reports_until_end(client)
    # Drive there, enter the dock, lift, leave the dock: each action begins and succeeds.
    actions = [(each["action"]["type"], each["action"]["state"]) for each in reports[2:]]
    assert actions == [(kind, state) for kind in (1, 3, 5, 4) for state in (1, 4)]
    pose = client.chassis.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((8.0, -3.5, -math.pi / 2), abs=0.01)
    assert client.chassis.jack.height == pytest.approx(0.06)
    assert client.ask("woosh.robot.DeviceState")["software"] & 4
    client.ask("woosh.robot.ExecTask", {"type": 4, "direction": 2, "markNo": "K10"})
    reports_until_end(client)
    assert client.chassis.jack.height == 0.0


def test_mark_precedes_path_and_path_precedes_pose(client: SteppedClient) -> None:
    # Clients may send all three targets, with the unused ones empty.
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2", "planPath": {}, "pose": {}})
    assert reports_until_end(client)[-1]["dest"] == "A2"
    path = {"planPath": [{"path": {"poses": [{"x": 4, "y": 3}, {"x": 3, "y": 2, "theta": 1}]}}]}
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "", "planPath": path, "pose": {}})
    assert reports_until_end(client)[-1]["state"] == COMPLETED
    pose = client.chassis.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((3, 2, 1), abs=0.005)
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "", "planPath": {}, "pose": {"x": 1}})
    assert reports_until_end(client)[-1]["state"] == COMPLETED
    assert client.chassis.pose.x == pytest.approx(1.0, abs=0.005)


def test_changed_path_leads_to_the_same_goal(client: SteppedClient) -> None:
    client.subscribe("woosh.robot.NavPath")
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
    client.next_push("woosh.robot.NavPath")
    path: Json = {"planPath": [{"path": {"poses": [{"x": 0, "y": 0}, {"x": 1.23, "y": 2.34}]}}]}
    client.ask("woosh.robot.ChangeNavPath", {"paths": path})
    poses = client.next_push("woosh.robot.NavPath")["path"]["poses"]
    assert {"x": 0.0, "y": 0.0} in [{"x": each["x"], "y": each["y"]} for each in poses]
    # Also while it is paused.
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    path["planPath"][0]["path"]["poses"][0]["y"] = 0.5
    client.ask("woosh.robot.ChangeNavPath", {"paths": path})
    poses = client.ask("woosh.robot.NavPath")["path"]["poses"]
    assert {"x": 0.0, "y": 0.5} in [{"x": each["x"], "y": each["y"]} for each in poses]
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    client.next_push(PROC, lambda body: body["state"] == COMPLETED)
    assert client.chassis.pose.x == pytest.approx(5.0, abs=0.005)


def test_only_accurate_arrival_turns_to_the_heading(client: SteppedClient) -> None:
    for arrival, theta in ((1, 0.0), (2, 2.0)):
        client.ask("woosh.robot.InitRobot", {"pose": {"x": 3, "y": 0}})
        client.ask("woosh.robot.ExecTask", {"type": 1, "pose": {"x": 8, "y": 0, "theta": 2}})
        client.ask("woosh.robot.ChangeNavMode", {"navMode": {"type": arrival, "mode": 1}})
        client.next_push(PROC, lambda body: body["state"] == COMPLETED)
        assert client.chassis.pose.distance((8.0, 0.0)) < 0.01
        assert client.chassis.pose.theta == pytest.approx(theta, abs=0.01)


def test_navigation_mode_changes_the_speed_while_navigating(client: SteppedClient) -> None:
    answer = client.request("woosh.robot.ChangeNavMode", {"navMode": {"maxSpeed": 0.3}})
    assert (answer["ok"], "no effect" in answer["msg"]) == (True, True)
    client.subscribe("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
    client.next_push("woosh.robot.PoseSpeed", lambda body: body["twist"]["linear"] > 0.79)
    for speed in (-0.5, 1e-9):
        too_low = {"navMode": {"type": 2, "mode": 1, "maxSpeed": speed}}
        assert "speed" in client.refusal("woosh.robot.ChangeNavMode", too_low)
    client.ask("woosh.robot.ChangeNavMode", {"navMode": {"type": 2, "maxSpeed": 0.3}})
    client.next_push("woosh.robot.PoseSpeed", lambda body: 0.29 < body["twist"]["linear"] < 0.301)
    client.subscribe(PROC)
    speeds = []
    while (frame := client.receive())["type"] != PROC or frame["body"]["state"] not in ENDED:
        if frame["type"] == "woosh.robot.PoseSpeed":
            speeds.append(frame["body"]["twist"]["linear"])
    assert max(speeds) < 0.301


def test_remote_control_waits_for_a_pause_and_a_map_switch_for_the_end(
    client: SteppedClient,
) -> None:
    switch = ("woosh.robot.SwitchMap", {"sceneName": "scenex"})
    client.ask("woosh.robot.ExecTask", {"taskId": 8, "type": 1, "markNo": "A23"})
    client.next_push(PROC, lambda body: body["state"] == EXECUTING)
    assert "task 8 is driving" in client.refusal("woosh.robot.Twist", {"linear": 0.2})
    assert "task is running" in client.refusal(*switch)
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    client.ask("woosh.robot.Twist", {"linear": 0.2})
    assert client.refusal(*switch) == "task 8 is paused: cancel it first"
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    call, target = "woosh.ros.CallAction", {"x": 3, "y": -5}
    client.ask(call, {"moveBase": {"action": 1, "targetPose": target}})
    client.ask(call, {"moveBase": {"action": 2}})
    assert client.refusal(*switch) == "a navigation is paused: cancel it first"
    client.ask(call, {"moveBase": {"action": 0}})
    client.ask(*switch)


def test_failed_task_cannot_be_recovered_on_another_map(client: SteppedClient) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 1, "pose": {"x": 500.0}})
    client.next_push(PROC, lambda body: body["state"] == FAILED)
    client.ask("woosh.robot.SwitchMap", {"sceneName": "scenex"})
    text = client.refusal("woosh.robot.ActionOrder", {"order": 5})
    assert text == "no task is running: start one by ExecTask first"


def test_zero_twist_pauses_a_moving_task(client: SteppedClient) -> None:
    client.subscribe("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.ExecTask", {"taskId": 8, "type": 1, "markNo": "A23"})
    client.next_push("woosh.robot.PoseSpeed", lambda body: body["twist"]["linear"] > 0.5)
    answer = client.request("woosh.robot.Twist")
    assert (answer["ok"], answer["msg"]) == (
        True,
        "stopped: task 8 is paused, continue or cancel it",
    )
    # The pause is pushed before the answer and takes effect at once.
    paused = [each["body"] for each in client.pushes if each["type"] == PROC][-1]
    assert (paused["state"], paused["msg"]) == (PAUSED, "stopped by a velocity of zero")
    assert client.chassis.base.velocity.speed == 0.0
    client.pushes.clear()
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.next_push(PROC)["state"] == EXECUTING
    assert client.next_push(PROC)["state"] == COMPLETED


def test_history_keeps_the_last_fifty_tasks(client: SteppedClient) -> None:
    for number in range(1, 61):
        client.ask("woosh.robot.ExecTask", {"taskId": number, "type": 1, "markNo": "A2"})
    ids = [int(each["robotTaskId"]) for each in client.ask("woosh.robot.TaskHistory")["tes"]]
    # The last task may or may not have ended by now.
    assert ids in (list(range(10, 60)), list(range(11, 61)))
