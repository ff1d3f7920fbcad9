"""Modes, key switch, localisation, following, battery and status codes."""

from __future__ import annotations

import pytest

from tests.simulator.recorded_chassis import SteppedChassis, ask, wait_frame
from tests.simulator.sim_wire import Json, JsonClient, connected, pass_time
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator import SimulatedChassis
from woosh_robot_agent.simulator.body.base import STANDSTILL, Velocity
from woosh_robot_agent.simulator.chassis import TIME_STEP
from woosh_robot_agent.simulator.protocol.handlers import dispatch

PROC, MODE = "woosh.robot.TaskProc", "woosh.robot.Mode"
OPERATION, STATE = "woosh.robot.OperationState", "woosh.robot.RobotState"
ABNORMAL, CODES = "woosh.robot.count.AbnormalCodes", "woosh.robot.count.StatusCodes"
AUTO, MANUAL, MAINTAIN = 1, 2, 3
UNINIT, IDLE, FOLLOWING = 1, 2, 7
ACTION_WAIT = 5
TASK = ("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
STEP = {"mode": 1, "value": 10.0}
KEY = "key switch is at manual: turn it to automatic first"


def test_key_switch_overrides_the_control_mode(client: JsonClient) -> None:
    client.subscribe(MODE, OPERATION)
    client.simulator.set_key_switch(True)
    assert client.next_push(MODE)["ctrl"] == MANUAL
    assert client.next_push(OPERATION)["robot"] == 0
    for mode in (AUTO, MAINTAIN):
        assert client.refusal("woosh.robot.SwitchControlMode", {"mode": mode}) == KEY
    assert client.ask(MODE)["ctrl"] == MANUAL
    assert client.refusal("woosh.robot.Twist", {"linear": 0.2}) == KEY
    client.ask("woosh.robot.Twist")  # a stop is always accepted
    assert client.ask(CODES)["scs"][-1]["msg"] == "control mode is now manual"
    client.pushes.clear()
    client.simulator.set_key_switch(False)
    assert client.next_push(MODE)["ctrl"] == AUTO
    assert client.next_push(OPERATION)["robot"] == 1


def test_key_switch_restores_the_control_mode_chosen_by_request(client: JsonClient) -> None:
    client.ask("woosh.robot.SwitchControlMode", {"mode": MAINTAIN})
    client.simulator.set_key_switch(True)
    assert client.ask(MODE)["ctrl"] == MANUAL
    client.simulator.set_key_switch(False)
    assert client.ask(MODE)["ctrl"] == MAINTAIN
    assert "maintenance mode: switch" in client.refusal("woosh.robot.Twist", {"linear": 0.2})
    client.ask("woosh.robot.Twist")  # a stop is always accepted
    client.simulator.set_key_switch(True)
    client.ask("woosh.robot.SwitchControlMode", {"mode": MANUAL})
    client.simulator.set_key_switch(False)
    assert client.ask(MODE)["ctrl"] == MANUAL


@pytest.mark.chassis(initialised=False)
def test_uninitialised_chassis_needs_init_robot(client: JsonClient) -> None:
    client.subscribe(STATE, OPERATION)
    info = client.ask("woosh.robot.RobotInfo")
    assert (info["state"], info["operationState"]["robot"]) == (UNINIT, 0)
    assert info["deviceState"]["software"] & 1 == 0
    assert client.refusal(*TASK) == "robot is not initialised: send InitRobot first"
    client.ask("woosh.robot.InitRobot", {"isRecord": True})
    assert client.next_push(STATE)["state"] == IDLE
    assert client.next_push(OPERATION)["robot"] == 1
    client.ask(*TASK)


def test_robot_follows_its_leader_at_a_distance_until_it_loses_it(quick: SteppedChassis) -> None:
    model = quick.chassis
    ask(quick, "woosh.robot.InitRobot", pose={"x": 0.0, "y": 0.0})
    ask(quick, "woosh.robot.Follow", type=True)
    for x, y in ((2.5, 0.0), (4.0, 0.5), (4.5, 2.0)):
        model.obstacles.put("leader", x, y, 0.2)
        quick.run(15.0)
        assert 0.9 < model.pose.distance((x, y)) - 0.2 < 1.1
        assert abs(model.pose.bearing((x, y))) < 0.2
    odometer = model.base.odometer
    quick.run(10.0)
    assert model.base.odometer == odometer
    model.obstacles.put("leader", 6.5, 2.0, 0.2)
    quick.run(1.0)
    assert model.base.moving
    model.obstacles.clear()
    quick.run(5.0)
    assert model.base.velocity == STANDSTILL
    assert ask(quick, STATE).body["state"] == FOLLOWING
    ask(quick, "woosh.robot.Follow", type=False)
    assert ask(quick, STATE).body["state"] == IDLE


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("woosh.robot.Twist", {}),
        ("woosh.robot.Twist", {"angular": 0.1}),
        ("woosh.robot.ExecTask", {"type": 1, "pose": {"x": -2}}),
        ("woosh.robot.SwitchControlMode", {"mode": 2}),
    ],
)
def test_following_ends_with_any_other_command(
    quick: SteppedChassis, name: str, body: Json
) -> None:
    ask(quick, "woosh.robot.Follow", type=True)
    assert quick.chassis.follower.active
    ask(quick, name, **body)
    quick.run(0.2)
    assert not quick.chassis.follower.active


def test_following_ends_with_a_job_that_goes_on(quick: SteppedChassis) -> None:
    step = [{"stepControl": {"action": action, "steps": [STEP]}} for action in (1, 2, 3)]
    ask(quick, "woosh.ros.CallAction", **step[0])
    ask(quick, "woosh.ros.CallAction", **step[1])
    ask(quick, "woosh.robot.Follow", type=True)
    assert quick.chassis.follower.active
    ask(quick, "woosh.ros.CallAction", **step[2])
    assert not quick.chassis.follower.active
    # A task that waits, too.
    ask(quick, "woosh.robot.ExecPreTask", taskSetId=777)
    wait_frame(quick, lambda frame: frame.type == PROC and frame.body["state"] == ACTION_WAIT)
    ask(quick, "woosh.robot.Follow", type=True)
    assert quick.chassis.follower.active
    ask(quick, "woosh.robot.ActionOrder", order=3)
    wait_frame(quick, lambda frame: frame.type == PROC and frame.body["robotTaskId"] == "77702")
    quick.run(TIME_STEP)
    assert not quick.chassis.follower.active
    # And one that was paused.
    ask(quick, "woosh.robot.ActionOrder", order=2)
    ask(quick, "woosh.robot.Follow", type=True)
    ask(quick, "woosh.robot.ActionOrder", order=3)
    assert not quick.chassis.follower.active


def test_battery_drains_with_motion_and_charges_at_the_dock(quick: SteppedChassis) -> None:
    battery = quick.chassis.battery
    battery.level = 60.4
    ask(quick, "woosh.robot.ExecTask", type=3, markNo="C1")
    charging = 7
    wait_frame(
        quick,
        lambda frame: frame.type == PROC and frame.body.get("action", {}).get("type") == charging,
    )
    before = battery.level
    assert before < 60.4 - 15 * 0.005  # the way is longer than 15 m
    quick.run(60.0)
    assert battery.level > before + 0.9
    assert ask(quick, "woosh.robot.Battery").body["chargeState"] == 3
    assert ask(quick, STATE).body["state"] == 8
    ask(quick, "woosh.robot.ActionOrder", order=4)
    assert ask(quick, "woosh.robot.Battery").body["chargeState"] == 1


def test_empty_battery_refuses_motion_until_it_is_charged(client: JsonClient) -> None:
    client.subscribe(ABNORMAL)
    client.simulator.call(lambda s: setattr(s.chassis.battery, "level", 0.0))
    assert [each["code"] for each in client.next_push(ABNORMAL)["scs"]] == ["110401000111"]
    assert client.refusal(*TASK) == "battery is empty: charge first"
    assert client.refusal("woosh.robot.Twist", {"linear": 0.2}) == "battery is empty: charge first"
    assert client.ask(STATE)["state"] == 5
    client.simulator.call(lambda s: setattr(s.chassis.battery, "level", 50.0))
    pass_time(client.simulator, 0.1)
    client.ask(*TASK)


def test_zero_twist_stops_and_is_pushed_at_once(client: JsonClient) -> None:
    def stop_while_it_drives(simulator: SimulatedChassis) -> tuple[bool, Velocity]:
        # Step by hand: on the running clock the command could time out first.
        chassis = simulator.chassis
        dispatch(chassis, Twist(linear=0.5, angular=0.5))
        for _ in range(5):
            chassis.tick(TIME_STEP)
        moving = chassis.base.moving
        dispatch(chassis, Twist())
        return moving, chassis.base.velocity

    client.subscribe("woosh.robot.PoseSpeed")
    assert client.simulator.call(stop_while_it_drives) == (True, STANDSTILL)
    assert client.next_push("woosh.robot.PoseSpeed")["twist"] == {"linear": 0.0, "angular": 0.0}


@pytest.mark.parametrize("omnidirectional", [True, False])
def test_only_an_omnidirectional_base_moves_sideways(omnidirectional: bool) -> None:
    lateral = {"mode": 3, "value": 0.5}
    diagonal = {"mode": 4, "value": 0.5, "angle": 0.5}
    with connected(speed=50, omnidirectional=omnidirectional) as client:
        assert client.ask("woosh.robot.General")["driverMethod"] == int(omnidirectional)
        mileage = client.simulator.state.odometer
        requests: list[tuple[str, Json]] = [
            ("woosh.robot.Twist", {"linearY": 0.3}),
            ("woosh.ros.CallAction", {"stepControl": {"action": 1, "steps": [lateral]}}),
            ("woosh.ros.CallAction", {"stepControl": {"action": 1, "steps": [diagonal]}}),
        ]
        for name, body in requests:
            if omnidirectional:
                client.ask(name, body)
                pass_time(client.simulator, 5.0)
            else:
                assert "a differential base cannot move sideways" in client.refusal(name, body)
        driven = client.simulator.state.odometer - mileage
        assert (driven > 1.0) is omnidirectional
        assert client.ask("woosh.robot.PoseSpeed")["mileage"] == int(mileage + driven)
