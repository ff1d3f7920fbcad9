"""The actions of CallAction and their feedback."""

from __future__ import annotations

import math

import pytest

from tests.simulator.recorded_chassis import SteppedClient
from tests.simulator.sim_wire import Json

CALL = "woosh.ros.CallAction"
FEEDBACKS = "woosh.ros.Feedbacks"
SUCCESS, FAILURE, CANCEL, EXECUTING, PAUSE, EXECUTE_FAILED = 1, -1, -2, 2, 3, 5
TERMINAL = (SUCCESS, FAILURE, CANCEL, EXECUTE_FAILED)


@pytest.fixture
def client() -> SteppedClient:
    return SteppedClient()


@pytest.fixture(autouse=True)
def _subscribed(client: SteppedClient) -> None:
    client.subscribe(FEEDBACKS)


def next_feedback(client: SteppedClient) -> Json:
    (one,) = client.next_push(FEEDBACKS)["fbs"]
    found: Json = one
    return found


def feedback_until_end(client: SteppedClient) -> list[Json]:
    """Return all feedback up to the end of an action."""
    found = [next_feedback(client)]
    while found[-1]["state"] not in TERMINAL:
        found.append(next_feedback(client))
    return found


def wait_state(client: SteppedClient, state: int) -> None:
    """Wait for feedback with this state."""
    client.next_push(FEEDBACKS, lambda body: body["fbs"][0]["state"] == state)


def step_request(mode: int, value: float, **more: float) -> Json:
    return {"stepControl": {"action": 1, "steps": [{"mode": mode, "value": value, **more}]}}


STEPS = [
    (1, 2.0, 0.0, (2.0, 0.0, 0.0)),
    (1, -0.5, 0.0, (-0.5, 0.0, 0.0)),
    (2, 3.14, 0.0, (0.0, 0.0, 3.14)),
    (2, -1.0, 0.0, (0.0, 0.0, -1.0)),
    (3, 0.7, 0.0, (0.0, 0.7, 0.0)),
    (4, 1.0, -math.pi / 4, (math.sqrt(0.5), -math.sqrt(0.5), 0.0)),
    (1, 0.0, 0.0, (0.0, 0.0, 0.0)),
]
"""Modes of steps, their values and angles, and the changes of the pose."""


def test_step_moves_the_base_by_its_value(client: SteppedClient) -> None:
    for mode, value, angle, expected in STEPS:
        client.ask("woosh.robot.InitRobot", {"pose": {"x": 3, "y": 0, "theta": 0}})
        client.ask(CALL, step_request(mode, value, speed=0.78, angle=angle))
        reports = feedback_until_end(client)
        assert {each["action"] for each in reports} == {"woosh.ros.action.StepControl"}
        assert [each["state"] for each in reports[:-1]] == [EXECUTING] * (len(reports) - 1)
        assert reports[-1]["state"] == SUCCESS
        pose = client.chassis.pose
        assert (pose.x - 3, pose.y, pose.theta) == pytest.approx(expected, abs=1e-5)
    client.ask(CALL, step_request(1, 0.1, speed=0.01))  # the minimum, with a rounding error


def test_lift_actions_reach_their_heights(client: SteppedClient) -> None:
    client.ask(CALL, {"liftControl": {"action": 1, "executeMode": 1}})
    assert feedback_until_end(client)[-1]["state"] == SUCCESS
    assert client.chassis.jack.height == pytest.approx(0.06)
    client.ask(CALL, {"liftControl": {"action": 1, "executeMode": 2}})
    assert feedback_until_end(client)[-1]["state"] == SUCCESS
    assert client.chassis.jack.height == 0.0
    moves = [(1, 0.5, 0.5), (2, 0.2, 0.7), (2, -0.1, 0.6), (3, 0, 0), (4, 0, 0)]
    moves += [(2, 0.1, 0.1), (2, 0.1, 0.2), (2, 0.1, 0.3), (2, -0.3, 0)]  # with rounding errors
    for mode, height, there in moves:
        lift3 = {"action": 1, "executeMode": mode, "speed": 0.2, "height": height}
        client.ask(CALL, {"liftControl3": lift3})
        end = feedback_until_end(client)[-1]
        assert (end["action"], end["state"]) == ("woosh.ros.action.LiftControl3", SUCCESS)
        assert client.chassis.column.height == pytest.approx(there, abs=1e-6)
    client.ask(CALL, {"liftControl2": {"action": 1, "height": 0.4}})
    feedback_until_end(client)
    client.ask(CALL, {"liftControl3": {"action": 1, "executeMode": 0}})
    assert feedback_until_end(client)[-1]["msg"] == "at 0.400 m"


TARGET = {"x": 0.57, "y": 2.54, "theta": 1.57}


def test_move_base_reaches_its_target_or_last_pose(client: SteppedClient) -> None:
    via = {"x": 3, "y": -2}
    for move in (
        {"poses": [TARGET], "targetPose": TARGET},
        {"poses": [via, TARGET], "targetPose": {}, "executionMode": 1},
    ):
        client.ask(CALL, {"moveBase": {"action": 1, **move}})
        reports = feedback_until_end(client)
        assert reports[-1]["state"] == SUCCESS
        assert len(reports) > 3
        pose = client.chassis.pose
        assert (pose.x, pose.y, pose.theta) == pytest.approx((0.57, 2.54, 1.57), abs=0.005)


def test_action_can_be_paused_resumed_and_cancelled(client: SteppedClient) -> None:
    client.ask("woosh.robot.InitRobot", {"pose": {"x": 3, "y": 0, "theta": 0}})
    client.ask(CALL, step_request(1, 2.0, speed=0.1))
    assert next_feedback(client)["state"] == EXECUTING
    client.ask(CALL, {"stepControl": {"action": 2}})
    wait_state(client, PAUSE)
    assert client.ask("woosh.robot.OperationState")["robot"] == 1
    client.ask(CALL, {"stepControl": {"action": 3}})
    assert feedback_until_end(client)[-1]["state"] == SUCCESS
    assert client.chassis.pose.x == pytest.approx(5.0, abs=1e-5)
    client.ask(CALL, step_request(1, -3.0, speed=0.1))
    client.ask(CALL, {"stepControl": {"action": 0}})
    assert feedback_until_end(client)[-1]["state"] == CANCEL
    for action in (0, 2, 3):
        assert "not running" in client.refusal(CALL, {"stepControl": {"action": action}})


def test_newer_motion_replaces_a_step_but_a_lift_does_not(client: SteppedClient) -> None:
    client.ask(CALL, step_request(1, 3.0, speed=0.05))
    client.ask(CALL, {"liftControl": {"action": 1, "executeMode": 1}})
    end = feedback_until_end(client)[-1]
    assert (end["action"], end["state"]) == ("woosh.ros.action.LiftControl", SUCCESS)
    client.pushes.clear()
    client.ask(CALL, {"moveBase": {"action": 1, "targetPose": {"x": 3, "y": -5}}})
    # The cancellation is pushed before the answer.
    ends = [frame["body"]["fbs"][0] for frame in client.pushes if frame["type"] == FEEDBACKS]
    assert (ends[-1]["action"], ends[-1]["state"]) == ("woosh.ros.action.StepControl", CANCEL)
    assert "replaced" in ends[-1]["msg"]


def test_task_replaces_a_step_and_refuses_another(client: SteppedClient) -> None:
    client.subscribe("woosh.robot.TaskProc")
    client.ask(CALL, step_request(1, 3.0, speed=0.1))
    client.ask("woosh.robot.ExecTask", {"taskId": 4, "type": 1, "markNo": "A23"})
    assert feedback_until_end(client)[-1]["state"] == CANCEL
    assert "task 4 is running" in client.refusal(CALL, step_request(1, 1.0))
    client.ask(CALL, {"liftControl": {"action": 1, "executeMode": 1}})
    # A paused task releases the wheels, and can continue only when they are free.
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    client.ask(CALL, step_request(1, 3.0, speed=0.1))
    assert "StepControl is running" in client.refusal("woosh.robot.ActionOrder", {"order": 3})
    client.ask(CALL, {"stepControl": {"action": 0}})
    client.ask("woosh.robot.ActionOrder", {"order": 3})


CANCELS: list[tuple[Json, Json]] = [
    (step_request(1, 3.0, speed=0.1), {"stepControl": {"steps": [{"mode": 1, "value": 1}]}}),
    (
        {"moveBase": {"action": 1, "targetPose": {"x": 3, "y": -5}}},
        {"moveBase": {"targetPose": {"x": 1, "y": -5}, "poses": [{"x": 1, "y": -5}]}},
    ),
    (
        {"liftControl3": {"action": 1, "executeMode": 1, "height": 0.5, "speed": 0.01}},
        {"liftControl3": {"executeMode": 1, "height": 0.1}},
    ),
]
"""Commands, and those that cancel them."""


def test_cancel_moves_nothing_whatever_else_the_command_contains(client: SteppedClient) -> None:
    before = client.chassis.pose, client.chassis.column.height
    for _, cancel in CANCELS:
        assert "is not running" in client.refusal(CALL, cancel)
    assert (client.chassis.pose, client.chassis.column.height) == before
    for start, cancel in CANCELS:
        client.ask(CALL, start)
        assert next_feedback(client)["state"] == EXECUTING
        client.ask(CALL, cancel)
        assert feedback_until_end(client)[-1]["state"] == CANCEL


def test_emergency_stop_ends_actions(client: SteppedClient) -> None:
    client.ask(CALL, step_request(1, 3.0, speed=0.1))
    assert next_feedback(client)["state"] == EXECUTING
    client.chassis.set_emergency_stop(True)
    end = feedback_until_end(client)[-1]
    assert (end["state"], end["msg"]) == (EXECUTE_FAILED, "emergency stop is pressed")
    assert client.chassis.base.velocity.speed == 0.0


CHARGE = {"chargeControl": {"action": 1, "executeMode": 1}}
EXIT = {"chargeControl": {"action": 1, "executeMode": 2}}


def wait_charge_state(client: SteppedClient, state: int) -> None:
    while client.ask("woosh.robot.Battery")["chargeState"] != state:
        client.run(0.1)


def test_charge_control_starts_pauses_and_stops_charging(client: SteppedClient) -> None:
    client.ask("woosh.robot.InitRobot", {"pose": {"x": -10.8, "y": 0.5, "theta": 3.14}})
    client.ask(CALL, CHARGE)
    for action, state, charge_state in ((2, PAUSE, 1), (3, EXECUTING, 3), (0, CANCEL, 1)):
        client.ask(CALL, {"chargeControl": {"action": action}})
        wait_state(client, state)
        wait_charge_state(client, charge_state)
    client.ask(CALL, CHARGE)
    wait_charge_state(client, 3)
    client.pushes.clear()
    client.ask(CALL, EXIT)
    ends = [feedback_until_end(client)[-1] for _ in range(2)]
    assert [(each["state"], each["msg"]) for each in ends] == [
        (CANCEL, "replaced by ChargeControl"),
        (SUCCESS, "1 of 1 steps done"),
    ]
    assert client.ask("woosh.robot.Battery")["chargeState"] == 1
    assert client.ask("woosh.robot.RobotState")["state"] == 2
    pose = client.chassis.pose
    assert (pose.x, pose.y) == pytest.approx((-10.3, 0.5), abs=0.01)


def test_leaving_a_charger_elsewhere_succeeds_without_moving(client: SteppedClient) -> None:
    odometer = client.chassis.base.odometer
    client.ask(CALL, EXIT)
    assert feedback_until_end(client)[-1]["msg"] == "not at a charger"
    assert client.chassis.base.odometer == odometer


def test_leaving_a_charger_ends_the_charge_even_if_the_robot_was_placed_elsewhere() -> None:
    client = SteppedClient(profile="tr200")
    client.subscribe(FEEDBACKS)
    client.ask("woosh.robot.InitRobot", {"pose": {"x": -10.8, "y": 0.5, "theta": 3.14}})
    client.run(10.0)
    client.ask(CALL, CHARGE)
    assert feedback_until_end(client)[-1]["state"] == SUCCESS
    assert client.ask("woosh.robot.Battery")["chargeState"] == 3
    client.ask("woosh.robot.SetRobotPose", {"pose": {"x": 3, "y": 0}})
    client.ask(CALL, EXIT)
    assert feedback_until_end(client)[-1]["state"] == SUCCESS
    assert client.ask("woosh.robot.Battery")["chargeState"] == 1


def test_leaving_a_charger_is_refused_while_a_task_charges(client: SteppedClient) -> None:
    client.subscribe(FEEDBACKS, "woosh.robot.TaskProc")
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 3, "markNo": "C1"})
    client.next_push("woosh.robot.TaskProc", lambda body: body.get("action", {}).get("type") == 7)
    assert client.refusal(CALL, EXIT).startswith("task 5 is running")


def test_path_requests_refer_to_the_job_that_drives(client: SteppedClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 8, "type": 1, "markNo": "A23"})
    client.ask("woosh.robot.ActionOrder", {"order": 2})

    def goal() -> Json | None:
        segments = client.ask("woosh.robot.PlanPath")["planPath"]
        return segments[0]["target"] if segments else None

    paused = goal()
    target = {"x": 3.0, "y": -5.0, "theta": 0.0}
    client.ask(CALL, {"moveBase": {"action": 1, "targetPose": target}})
    assert goal() == target
    client.next_push(FEEDBACKS)
    via = [{"x": 3.0, "y": -4.0, "theta": 0.0}]
    client.ask("woosh.robot.ChangeNavPath", {"paths": {"planPath": [{"path": {"poses": via}}]}})
    path = client.ask("woosh.robot.NavPath")["path"]["poses"]
    assert path[-1] == target
    assert (3.0, -4.0) in [(pose["x"], pose["y"]) for pose in path]
    client.ask(CALL, {"moveBase": {"action": 0}})
    assert goal() == paused
    client.ask(CALL, step_request(2, 3.0))
    assert goal() is None


def test_path_requests_refer_to_the_action_for_which_a_task_waits(client: SteppedClient) -> None:
    client.subscribe("woosh.robot.TaskProc")
    client.ask("woosh.robot.ExecPreTask", {"taskSetId": 777})
    client.next_push("woosh.robot.TaskProc", lambda body: body["state"] == 5)  # it waits
    target = {"x": 3.0, "y": -5.0, "theta": 0.0}
    client.ask(CALL, {"moveBase": {"action": 1, "targetPose": target}})
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    client.next_push("woosh.robot.TaskProc", lambda body: body["robotTaskId"] == "77702")
    client.next_push("woosh.robot.TaskProc", lambda body: body["state"] == 3)
    (segment,) = client.ask("woosh.robot.PlanPath")["planPath"]
    assert segment["target"] == target


def test_zero_twist_pauses_a_moving_action(client: SteppedClient) -> None:
    client.ask(CALL, step_request(1, 3.0, speed=0.5))
    client.ask(CALL, {"liftControl": {"action": 1, "executeMode": 1}})
    answer = client.request("woosh.robot.Twist")
    assert answer["msg"] == "stopped: StepControl is paused, continue or cancel it"
    assert client.chassis.base.velocity.speed == 0.0
    states: dict[str, int] = {}
    expected = {"woosh.ros.action.LiftControl": SUCCESS, "woosh.ros.action.StepControl": PAUSE}
    while states != expected:
        one = next_feedback(client)
        states[one["action"]] = one["state"]
    client.ask(CALL, {"stepControl": {"action": 3}})
    assert feedback_until_end(client)[-1]["state"] == SUCCESS


def test_move_base_to_a_pose_that_cannot_be_reached_reports_a_status_code(
    client: SteppedClient,
) -> None:
    for target, code in (
        ({"x": -4.8, "y": -6.0}, "130101000011"),  # too close to a wall to stand there
        ({"x": 500.0, "y": 0.0}, "130101000021"),  # outside the map
    ):
        client.ask(CALL, {"moveBase": {"action": 1, "poses": [target], "targetPose": target}})
        end = feedback_until_end(client)[-1]
        assert (end["state"], end["code"]) == (FAILURE, code)
        assert "no free path" in end["msg"]
