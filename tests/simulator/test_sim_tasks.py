"""Tasks from their order to their end."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from tests.simulator.sim_wire import Json, JsonClient, pass_time
from woosh_robot_agent.simulator import SimulatorThread

PROC = "woosh.robot.TaskProc"
INIT, READY, EXECUTING, PAUSED, ACTION_WAIT = 1, 2, 3, 4, 5
COMPLETED, CANCELED, FAILED = 7, 8, 9
ENDED = (COMPLETED, CANCELED, FAILED)


@pytest.fixture(autouse=True)
def _subscribed(client: JsonClient) -> None:
    client.subscribe(PROC)


def life(client: JsonClient) -> list[Json]:
    """All reports of the task that comes next, up to its end."""
    reports = [client.push(PROC)]
    while reports[-1]["state"] not in ENDED:
        reports.append(client.push(PROC))
    return reports


def test_task_to_a_mark(simulator: SimulatorThread, client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": "1682416646", "type": 1, "markNo": "A2"})
    reports = life(client)
    assert [each["state"] for each in reports] == [INIT, READY, EXECUTING, COMPLETED]
    for each in reports:
        assert (each["robotTaskId"], each["type"], each["dest"]) == ("1682416646", 1, "A2")
    assert reports[2]["action"] == {"type": 1, "state": 1, "waitId": 0}
    assert reports[3]["action"] == {"type": 1, "state": 4, "waitId": 0}
    pose = simulator.state.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((5.0, 4.0, 0.0), abs=0.005)
    info = client.ask("woosh.robot.RobotInfo")
    assert info["taskProc"] == reports[-1] == client.ask(PROC)
    assert info["taskHistory"]["tes"] == [reports[-1]]
    assert info["state"] == 2


def test_while_it_runs(client: JsonClient) -> None:
    client.subscribe("woosh.robot.NavPath", "woosh.robot.RobotState", "woosh.robot.PoseSpeed")
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
    assert client.push("woosh.robot.RobotState")["state"] == 4
    path = client.push("woosh.robot.NavPath")["path"]["poses"]
    assert len(path) > 2
    assert path[-1]["x"] == pytest.approx(-9.5)
    plan = client.ask("woosh.robot.PlanPath")["planPath"]
    assert plan[0]["path"]["poses"] == path
    client.push("woosh.robot.PoseSpeed", lambda body: body["twist"]["linear"] > 0.7)
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    assert client.push("woosh.robot.NavPath")["path"]["poses"] == []
    codes = client.ask("woosh.robot.count.StatusCodes")["scs"]
    assert {"130104000000", "130104000061"} <= {code["code"] for code in codes}


def test_pose_pushes_only_while_moving(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe("woosh.robot.PoseSpeed")
    client.send({"type": "woosh.robot.Twist", "body": {"linear": 0.5}, "sn": 999})
    stamps: list[int] = []
    speed = 0.5
    while speed > 0.0:
        frame = client.receive()
        if frame["type"] == "woosh.robot.PoseSpeed":
            stamps.append(frame["timestamp"])
            speed = frame["body"]["twist"]["linear"]
    assert all(later - earlier == 50 for earlier, later in pairwise(stamps))
    client.taken("woosh.robot.PoseSpeed")
    pass_time(simulator, 5.0)
    assert client.taken("woosh.robot.PoseSpeed") == []


def test_task_ids_are_fresh(client: JsonClient) -> None:
    ids = []
    for _ in range(3):
        client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
        ids.append(int(client.ask(PROC)["robotTaskId"]))
    assert ids == sorted(set(ids))
    assert ids[0] > 1_700_000_000


def test_newer_task_replaces_the_older_one(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 1, "type": 1, "markNo": "A23"})
    client.push(PROC, lambda body: body["state"] == EXECUTING)
    client.ask("woosh.robot.ExecTask", {"taskId": 2, "type": 1, "markNo": "A2"})
    # The old task's end came before the answer.
    (end,) = [frame["body"] for frame in client.pushes if frame["type"] == PROC]
    assert (end["robotTaskId"], end["state"]) == ("1", CANCELED)
    assert "replaced" in end["msg"]
    client.pushes.clear()
    reports = life(client)
    assert {each["robotTaskId"] for each in reports} == {"2"}
    assert reports[-1]["state"] == COMPLETED


def test_pause_continue_cancel(simulator: SimulatorThread, client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
    client.push(PROC, lambda body: body["state"] == EXECUTING)
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    paused = client.push(PROC)
    assert (paused["state"], paused["action"]["state"]) == (PAUSED, 10)
    assert client.ask("woosh.robot.RobotState")["state"] == 4
    pass_time(simulator, 2.0)
    assert client.ask("woosh.robot.PoseSpeed")["twist"]["linear"] == 0.0
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.push(PROC)["state"] == EXECUTING
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    end = client.push(PROC)
    assert (end["state"], end["action"]["state"]) == (CANCELED, 3)
    assert "no task" in client.refused("woosh.robot.ActionOrder", {"order": 4})


def test_failure_and_recovery(client: JsonClient) -> None:
    client.subscribe("woosh.robot.count.StatusCode")
    # Beside the partition: too near to it to stand there.
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "pose": {"x": -4.8, "y": -6}})
    end = client.push(PROC, lambda body: body["state"] in ENDED)
    assert end["state"] == FAILED
    assert "no free path" in end["msg"]
    last = client.ask("woosh.robot.count.StatusCodes")["scs"][-1]
    assert (last["level"], last["robotTaskId"]) == (3, "5")
    assert "no free path" in last["msg"]
    client.ask("woosh.robot.ActionOrder", {"order": 5})
    assert client.push(PROC)["state"] == EXECUTING
    assert client.push(PROC)["state"] == FAILED


def test_task_set(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 666})
    first, second = life(client), life(client)
    assert {each["robotTaskId"] for each in first} == {"66601"}
    assert {each["robotTaskId"] for each in second} == {"66602"}
    assert first[-1]["state"] == second[-1]["state"] == COMPLETED
    history = client.ask("woosh.robot.TaskHistory")["tes"]
    assert [each["robotTaskId"] for each in history] == ["66601", "66602"]


def test_cancelling_a_set_ends_it(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 666})
    client.push(PROC, lambda body: body["state"] == EXECUTING)
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    assert client.push(PROC)["state"] == CANCELED
    assert client.taken(PROC) == []
    assert client.ask("woosh.robot.RobotState")["state"] == 2


def test_wait_of_a_set_ends_by_itself_or_by_order(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 777})
    client.push(PROC, lambda body: body["state"] == ACTION_WAIT)
    client.ask("woosh.robot.ActionOrder", {"order": 6})
    assert client.push(PROC)["state"] == COMPLETED
    waiting = client.push(PROC, lambda body: body["state"] == ACTION_WAIT)
    assert waiting["action"] == {"type": 6, "state": 1, "waitId": 2}
    end = client.push(PROC)
    assert end["state"] == COMPLETED
    assert 4 <= end["time"] - waiting["time"] <= 6


def test_a_wait_without_an_end_lasts_until_the_order(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 777})
    waiting = client.push(PROC, lambda body: body["state"] == ACTION_WAIT)
    assert waiting["action"] == {"type": 6, "state": 1, "waitId": 1}
    pass_time(simulator, 600.0)
    # It can be paused meanwhile, and waits on afterwards.
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    assert client.push(PROC)["state"] == PAUSED
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.push(PROC)["state"] == ACTION_WAIT
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.push(PROC)["state"] == COMPLETED
    second = life(client)
    assert {each["robotTaskId"] for each in second} == {"77702"}
    assert second[-1]["state"] == COMPLETED


def test_a_set_is_repeated(client: JsonClient) -> None:
    repeats = client.ask("woosh.task.RepeatTasks")["repeatTasks"]
    (times,) = [each["times"] for each in repeats if each["taskSet"]["base"]["id"] == 1735291765]
    assert times == 2
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 1735291765})
    for _ in range(times):
        reports = life(client)
        assert {each["robotTaskId"] for each in reports} == {"173529176501"}
        assert reports[-1]["state"] == COMPLETED
    assert client.taken(PROC) == []


def test_emergency_stop_pauses_and_recovery_goes_on(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
    client.push(PROC, lambda body: body["state"] == EXECUTING)
    simulator.set_emergency_stop(True)
    paused = client.push(PROC)
    assert (paused["state"], paused["msg"]) == (PAUSED, "emergency stop is pressed")
    assert simulator.state.velocity.speed == 0.0
    simulator.set_emergency_stop(False)
    pass_time(simulator, 10.0)
    # Nobody moves by himself because somebody released a button.
    assert client.taken(PROC) == []
    client.ask("woosh.robot.ActionOrder", {"order": 5})
    assert client.push(PROC)["state"] == EXECUTING
    assert client.push(PROC)["state"] == COMPLETED


def test_charge_task_charges(simulator: SimulatorThread, client: JsonClient) -> None:
    simulator.call(lambda s: setattr(s.chassis.battery, "level", 97.0))
    client.subscribe("woosh.robot.Battery", "woosh.robot.RobotState")
    client.ask("woosh.robot.ExecTask", {"type": 3, "markNo": "C1"})
    reports = life(client)
    assert [each["action"]["type"] for each in reports[2:]] == [1, 1, 3, 3, 7, 7]
    assert reports[-1]["state"] == COMPLETED
    info = client.ask("woosh.robot.RobotInfo")
    assert (info["state"], info["battery"]["power"]) == (2, 98)
    battery = client.ask("woosh.robot.Battery")
    assert (battery["chargeState"], battery["power"]) == (1, 98)
    assert client.ask("woosh.robot.RobotState")["state"] == 2


def test_parking_task_parks(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe("woosh.robot.RobotState")
    client.ask("woosh.robot.ExecTask", {"type": 2, "markNo": "P1"})
    assert client.push("woosh.robot.RobotState")["state"] == 3
    reports = life(client)
    assert [each["state"] for each in reports] == [INIT, READY, EXECUTING, COMPLETED]
    assert {(each["type"], each["dest"]) for each in reports} == {(2, "P1")}
    assert client.push("woosh.robot.RobotState")["state"] == 2
    assert simulator.state.pose.distance((10.5, -8.5)) < 0.01


def test_carry_task_lifts(simulator: SimulatorThread, client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 4, "direction": 1, "markNo": "K10"})
    reports = life(client)
    # There, into the dock, lifting, out of the dock: each one begins and succeeds.
    actions = [(each["action"]["type"], each["action"]["state"]) for each in reports[2:]]
    assert actions == [(kind, state) for kind in (1, 3, 5, 4) for state in (1, 4)]
    pose = simulator.state.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((8.0, -3.5, -math.pi / 2), abs=0.01)
    assert simulator.state.jack == pytest.approx(0.06)
    assert client.ask("woosh.robot.DeviceState")["software"] & 4
    client.ask("woosh.robot.ExecTask", {"type": 4, "direction": 2, "markNo": "K10"})
    life(client)
    assert simulator.state.jack == 0.0


def test_mark_then_path_then_pose(simulator: SimulatorThread, client: JsonClient) -> None:
    # Clients that send every field send the ones that they don't mean empty.
    client.ask("woosh.robot.ExecTask", {"markNo": "A2", "planPath": {}, "pose": {}})
    assert life(client)[-1]["dest"] == "A2"
    path = {"planPath": [{"path": {"poses": [{"x": 4, "y": 3}, {"x": 3, "y": 2, "theta": 1}]}}]}
    client.ask("woosh.robot.ExecTask", {"markNo": "", "planPath": path, "pose": {}})
    assert life(client)[-1]["state"] == COMPLETED
    pose = simulator.state.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((3, 2, 1), abs=0.005)
    client.ask("woosh.robot.ExecTask", {"markNo": "", "planPath": {}, "pose": {"x": 1}})
    assert life(client)[-1]["state"] == COMPLETED
    assert simulator.state.pose.x == pytest.approx(1.0, abs=0.005)


def test_new_path_leads_to_the_same_goal(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe("woosh.robot.NavPath")
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
    client.push("woosh.robot.NavPath")
    path = {"planPath": [{"path": {"poses": [{"x": 0, "y": 0}, {"x": 1.23, "y": 2.34}]}}]}
    client.ask("woosh.robot.ChangeNavPath", {"paths": path})
    poses = client.push("woosh.robot.NavPath")["path"]["poses"]
    assert {"x": 0.0, "y": 0.0} in [{"x": each["x"], "y": each["y"]} for each in poses]
    client.push(PROC, lambda body: body["state"] == COMPLETED)
    assert simulator.state.pose.x == pytest.approx(5.0, abs=0.005)


def test_a_strict_path_is_driven_as_it_is(simulator: SimulatorThread, client: JsonClient) -> None:
    client.ask("woosh.robot.InitRobot", {"pose": {"x": 3, "y": 0}})
    client.subscribe("woosh.robot.NavPath", "woosh.robot.PoseSpeed")
    corners = [(4.0, 1.0), (5.0, -1.0), (6.0, 1.0), (6.0, 2.0)]
    poses = [{"x": x, "y": y, "theta": 1.0} for x, y in corners]
    path = {"planPath": [{"path": {"poses": poses}, "optimal": 9}]}
    client.ask("woosh.robot.ExecTask", {"planPath": path})
    driven = client.push("woosh.robot.NavPath")["path"]["poses"]
    assert [(each["x"], each["y"]) for each in driven] == [(3.0, 0.0), *corners]
    left = dict.fromkeys(corners, math.inf)
    while True:
        frame = client.receive()
        if frame["type"] == "woosh.robot.PoseSpeed":
            pose = frame["body"]["pose"]
            for corner in corners:
                left[corner] = min(left[corner], math.dist(corner, (pose["x"], pose["y"])))
        elif frame["type"] == PROC and frame["body"]["state"] in ENDED:
            break
    assert frame["body"]["state"] == COMPLETED
    assert max(left.values()) < 0.02
    assert simulator.state.pose.theta == pytest.approx(1.0, abs=0.005)


def test_more_poses_than_a_path_may_have_are_refused(client: JsonClient) -> None:
    poses = [{"x": 3.0 + index / 100} for index in range(201)]
    path = {"planPath": [{"path": {"poses": poses}}]}
    assert "201 poses" in client.refused("woosh.robot.ExecTask", {"planPath": path})


@pytest.mark.parametrize(("arrival", "turned"), [(1, False), (2, True)])
def test_arrival_is_vague_or_accurate(
    simulator: SimulatorThread, client: JsonClient, arrival: int, turned: bool
) -> None:
    client.ask("woosh.robot.InitRobot", {"pose": {"x": 3, "y": 0}})
    client.ask("woosh.robot.ExecTask", {"pose": {"x": 8, "y": 0, "theta": 2}})
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    client.ask("woosh.robot.ChangeNavMode", {"navMode": {"type": arrival, "mode": 1}})
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    client.push(PROC, lambda body: body["state"] == COMPLETED)
    pose = simulator.state.pose
    assert pose.distance((8.0, 0.0)) < 0.01
    assert pose.theta == pytest.approx(2.0 if turned else 0.0, abs=0.01)


def test_navigation_mode_counts_while_navigating(client: JsonClient) -> None:
    answer = client.request("woosh.robot.ChangeNavMode", {"navMode": {"maxSpeed": 0.3}})
    assert (answer["ok"], "no effect" in answer["msg"]) == (True, True)
    client.subscribe("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
    client.push("woosh.robot.PoseSpeed", lambda body: body["twist"]["linear"] > 0.79)
    client.ask("woosh.robot.ChangeNavMode", {"navMode": {"type": 2, "maxSpeed": 0.3}})
    client.push("woosh.robot.PoseSpeed", lambda body: 0.29 < body["twist"]["linear"] < 0.301)
    client.subscribe(PROC)
    speeds = []
    while (frame := client.receive())["type"] != PROC or frame["body"]["state"] not in ENDED:
        if frame["type"] == "woosh.robot.PoseSpeed":
            speeds.append(frame["body"]["twist"]["linear"])
    assert max(speeds) < 0.301


def test_leaving_automatic_mode_pauses(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
    client.push(PROC, lambda body: body["state"] == EXECUTING)
    client.ask("woosh.robot.SwitchControlMode", {"mode": 2})
    paused = client.push(PROC)
    assert (paused["state"], paused["msg"]) == (PAUSED, "robot is in manual mode")
    assert "manual" in client.refused("woosh.robot.ActionOrder", {"order": 3})
    client.ask("woosh.robot.SwitchControlMode", {"mode": 1})
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.push(PROC)["state"] == EXECUTING


def test_remote_control_waits_for_the_task(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 8, "type": 1, "markNo": "A23"})
    client.push(PROC, lambda body: body["state"] == EXECUTING)
    assert "task 8 is driving" in client.refused("woosh.robot.Twist", {"linear": 0.2})
    assert "task is running" in client.refused("woosh.robot.SwitchMap", {"sceneName": "scenex"})
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    client.ask("woosh.robot.Twist", {"linear": 0.2})


def test_the_map_stays_while_something_could_go_on(client: JsonClient) -> None:
    switch = ("woosh.robot.SwitchMap", {"sceneName": "scenex"})
    client.ask("woosh.robot.ExecTask", {"taskId": 8, "type": 1, "markNo": "A23"})
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    assert client.refused(*switch) == "task 8 is paused: cancel it first"
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    call, target = "woosh.ros.CallAction", {"x": 3, "y": -5}
    client.ask(call, {"moveBase": {"action": 1, "targetPose": target}})
    client.ask(call, {"moveBase": {"action": 2}})
    assert client.refused(*switch) == "a navigation is paused: cancel it first"
    client.ask(call, {"moveBase": {"action": 0}})
    client.ask(*switch)


def test_a_failed_task_is_not_recovered_on_another_map(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"type": 1, "pose": {"x": 500.0}})
    client.push(PROC, lambda body: body["state"] == FAILED)
    client.ask("woosh.robot.SwitchMap", {"sceneName": "scenex"})
    text = client.refused("woosh.robot.ActionOrder", {"order": 5})
    assert text == "no task is running: start one by ExecTask first"


def test_a_velocity_of_zero_stops_a_task_too(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    client.subscribe("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.ExecTask", {"taskId": 8, "type": 1, "markNo": "A23"})
    client.push("woosh.robot.PoseSpeed", lambda body: body["twist"]["linear"] > 0.5)
    answer = client.request("woosh.robot.Twist")
    assert (answer["ok"], answer["msg"]) == (
        True,
        "stopped: task 8 is paused, continue or cancel it",
    )
    # Said before the answer, and true at once.
    paused = [each["body"] for each in client.pushes if each["type"] == PROC][-1]
    assert (paused["state"], paused["msg"]) == (PAUSED, "stopped by a velocity of zero")
    assert simulator.state.velocity.speed == 0.0
    client.pushes.clear()
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.push(PROC)["state"] == EXECUTING
    assert client.push(PROC)["state"] == COMPLETED


def test_a_velocity_of_zero_leaves_a_wait_alone(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 777})
    client.push(PROC, lambda body: body["state"] == ACTION_WAIT)
    assert client.request("woosh.robot.Twist")["ok"]
    assert client.taken(PROC) == []


def test_following_ends_with_a_task(client: JsonClient) -> None:
    client.ask("woosh.robot.Follow", {"type": True})
    assert client.ask("woosh.robot.RobotState")["state"] == 7
    client.ask("woosh.robot.ExecTask", {"type": 2, "markNo": "P1"})
    assert client.ask("woosh.robot.RobotState")["state"] == 3


def test_history_keeps_fifty(client: JsonClient) -> None:
    for number in range(1, 61):
        client.ask("woosh.robot.ExecTask", {"taskId": number, "type": 1, "markNo": "A2"})
    ids = [int(each["robotTaskId"]) for each in client.ask("woosh.robot.TaskHistory")["tes"]]
    # Whether the last one has ended by now is a matter of time.
    assert ids in (list(range(10, 60)), list(range(11, 61)))


def test_a_paused_task_takes_another_way_at_once(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"markNo": "A23"})
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    corners = [{"x": 0.0, "y": 0.0}, {"x": 1.25, "y": 2.25}]
    client.ask("woosh.robot.ChangeNavPath", {"paths": {"planPath": [{"path": {"poses": corners}}]}})
    poses = client.ask("woosh.robot.NavPath")["path"]["poses"]
    assert {(1.25, 2.25), (0.0, 0.0)} <= {(pose["x"], pose["y"]) for pose in poses}


@pytest.mark.parametrize("speed", [-0.5, 1e-9])
def test_a_speed_that_leads_nowhere_is_refused(client: JsonClient, speed: float) -> None:
    client.ask("woosh.robot.ExecTask", {"markNo": "A23"})
    mode = {"type": 2, "mode": 1, "maxSpeed": speed}
    assert "speed" in client.refused("woosh.robot.ChangeNavMode", {"navMode": mode})
