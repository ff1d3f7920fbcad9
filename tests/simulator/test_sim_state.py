"""Modes, the key switch, localisation, following, the battery and the logs of what was wrong."""

from __future__ import annotations

import pytest

from tests.simulator.sim_wire import Json, JsonClient, pass_time
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator import (
    Outgoing,
    SimulatedChassis,
    SimulatorConfig,
    SimulatorThread,
)
from woosh_robot_agent.simulator.body.base import STANDSTILL, Velocity
from woosh_robot_agent.simulator.chassis import TIME_STEP
from woosh_robot_agent.simulator.protocol.dispatch import dispatch

PROC, MODE = "woosh.robot.TaskProc", "woosh.robot.Mode"
OPERATION, STATE = "woosh.robot.OperationState", "woosh.robot.RobotState"
ABNORMAL, CODES = "woosh.robot.count.AbnormalCodes", "woosh.robot.count.StatusCodes"
AUTO, MANUAL, MAINTAIN = 1, 2, 3
UNINIT, IDLE, FAULT, FOLLOWING = 1, 2, 6, 7
PAUSED = 4
TASK = ("woosh.robot.ExecTask", {"type": 1, "markNo": "A23"})
KEY = "key switch is at manual: turn it to automatic first"


def test_key_switch_overrules_the_mode(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(PROC, MODE, OPERATION)
    client.ask(*TASK)
    client.push(PROC, lambda body: body["state"] == 3)
    simulator.set_key_switch(True)
    paused = client.push(PROC)
    assert (paused["state"], paused["msg"]) == (PAUSED, "key switch is at manual")
    assert client.push(MODE)["ctrl"] == MANUAL
    assert client.push(OPERATION)["robot"] == 0
    for mode in (AUTO, MAINTAIN):
        assert client.refused("woosh.robot.SwitchControlMode", {"mode": mode}) == KEY
    assert client.ask(MODE)["ctrl"] == MANUAL
    assert client.refused(*TASK) == KEY
    assert client.refused("woosh.robot.ActionOrder", {"order": 3}) == KEY
    client.ask("woosh.robot.Twist", {"linear": 0.2})  # that is what manual is for
    assert "key switch turned to manual" in [each["msg"] for each in client.ask(CODES)["scs"]]
    client.pushes.clear()
    simulator.set_key_switch(False)
    assert client.push(MODE)["ctrl"] == AUTO
    assert client.push(OPERATION)["robot"] == 1
    pass_time(simulator, 5.0)
    assert client.taken(PROC) == []  # nothing goes on because somebody turned a key
    client.ask("woosh.robot.ActionOrder", {"order": 3})


def test_key_switch_keeps_what_software_chose(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    client.ask("woosh.robot.SwitchControlMode", {"mode": MAINTAIN})
    simulator.set_key_switch(True)
    assert client.ask(MODE)["ctrl"] == MANUAL
    simulator.set_key_switch(False)
    assert client.ask(MODE)["ctrl"] == MAINTAIN
    simulator.set_key_switch(True)
    client.ask("woosh.robot.SwitchControlMode", {"mode": MANUAL})
    simulator.set_key_switch(False)
    assert client.ask(MODE)["ctrl"] == MANUAL


def test_maintenance_mode_refuses_remote_control(client: JsonClient) -> None:
    client.ask("woosh.robot.SwitchControlMode", {"mode": MAINTAIN})
    assert "maintenance mode: switch" in client.refused("woosh.robot.Twist", {"linear": 0.2})
    client.ask("woosh.robot.Twist")  # a stop is always welcome
    client.ask("woosh.robot.SwitchControlMode", {"mode": MANUAL})
    client.ask("woosh.robot.Twist", {"linear": 0.2})


def test_lost_localisation(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(PROC, STATE, OPERATION, ABNORMAL, "woosh.robot.DeviceState")
    client.ask(*TASK)
    client.push(PROC, lambda body: body["state"] == 3)
    simulator.lose_localisation()
    paused = client.push(PROC)
    assert (paused["state"], paused["msg"]) == (PAUSED, "robot has lost its localisation")
    info = client.ask("woosh.robot.RobotInfo")
    assert info["state"] == FAULT
    assert info["operationState"]["robot"] == 0
    assert info["deviceState"]["software"] & 1 == 0
    assert [each["msg"] for each in info["abnormalCodes"]["scs"]] == ["localisation lost"]
    reason = "robot has lost its localisation: send InitRobot or SetRobotPose first"
    assert client.refused(*TASK) == reason
    client.pushes.clear()
    client.ask("woosh.robot.SetRobotPose", {"pose": {"x": 1, "y": 2}})
    assert client.push(ABNORMAL)["scs"] == []
    assert client.ask("woosh.robot.DeviceState")["software"] & 1
    assert client.ask(OPERATION)["robot"] == 1
    client.ask("woosh.robot.ActionOrder", {"order": 3})
    assert client.push(PROC, lambda body: body["state"] == 7)


def test_a_chassis_that_was_just_switched_on_wants_to_be_initialised() -> None:
    config = SimulatorConfig(port=0, tcp_port=0, speed=50, seed=1, initialised=False)
    with SimulatorThread(config) as simulator:
        client = JsonClient(simulator.port)
        client.subscribe(STATE, OPERATION)
        info = client.ask("woosh.robot.RobotInfo")
        assert (info["state"], info["operationState"]["robot"]) == (UNINIT, 0)
        assert info["deviceState"]["software"] & 1 == 0
        assert client.refused(*TASK) == "robot is not initialised: send InitRobot first"
        client.ask("woosh.robot.InitRobot", {"isRecord": True})
        assert client.push(STATE)["state"] == IDLE
        assert client.push(OPERATION)["robot"] == 1
        client.ask(*TASK)
        client.close()


@pytest.fixture
def leader(simulator: SimulatorThread, client: JsonClient) -> JsonClient:
    """Told to follow whoever stands before the robot."""
    client.ask("woosh.robot.InitRobot", {"pose": {"x": 0.0, "y": 0.0}})
    move(simulator, 2.5, 0.0)
    client.subscribe(STATE, "woosh.robot.PoseSpeed")
    client.ask("woosh.robot.Follow", {"type": True})
    assert client.push(STATE)["state"] == FOLLOWING
    return client


def move(simulator: SimulatorThread, x: float, y: float) -> None:
    simulator.call(lambda s: s.chassis.obstacles.put("leader", x, y, 0.2))


def gap(simulator: SimulatorThread, x: float, y: float) -> float:
    return simulator.state.pose.distance((x, y)) - 0.2


def test_it_follows_and_keeps_its_distance(simulator: SimulatorThread, leader: JsonClient) -> None:
    for x, y in ((2.5, 0.0), (4.0, 0.5), (4.5, 2.0)):
        move(simulator, x, y)
        pass_time(simulator, 15.0)
        assert 0.9 < gap(simulator, x, y) < 1.1
        assert abs(simulator.state.pose.bearing((x, y))) < 0.2
    odometer = simulator.state.odometer
    pass_time(simulator, 10.0)
    assert simulator.state.odometer == odometer


def test_it_stands_where_it_lost_whom_it_followed(
    simulator: SimulatorThread, leader: JsonClient
) -> None:
    simulator.call(lambda s: s.chassis.obstacles.clear())
    pass_time(simulator, 10.0)
    assert simulator.state.velocity.speed == 0.0
    assert leader.ask(STATE)["state"] == FOLLOWING
    leader.ask("woosh.robot.Follow", {"type": False})
    assert leader.ask(STATE)["state"] == IDLE


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("woosh.robot.Follow", {"type": False}),
        ("woosh.robot.Twist", {}),
        ("woosh.robot.Twist", {"angular": 0.1}),
        ("woosh.robot.ExecTask", {"pose": {"x": -2}}),
        ("woosh.robot.SwitchControlMode", {"mode": 2}),
    ],
)
def test_following_ends_with_any_other_command(
    simulator: SimulatorThread, leader: JsonClient, name: str, body: Json
) -> None:
    leader.ask(name, body)
    pass_time(simulator, 0.2)
    assert not simulator.state.following


def test_battery_drains_with_motion_and_charges_at_the_dock(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    levels: list[float] = []

    def note(out: Outgoing) -> list[Outgoing]:
        if out.type == PROC and out.body.action.type == 7:  # it charges
            levels.append(simulator._simulator.chassis.battery.level)
        return [out]

    simulator.intercept(note)
    client.subscribe(PROC, "woosh.robot.Battery")
    simulator.call(lambda s: setattr(s.chassis.battery, "level", 60.4))
    client.ask("woosh.robot.ExecTask", {"type": 3, "markNo": "C1"})
    client.push(PROC, lambda body: body.get("action", {}).get("type") == 7)
    assert levels[0] < 60.4 - 15 * 0.005  # the way is longer than 15 m
    charging = client.push("woosh.robot.Battery", lambda body: body["chargeState"] == 3)
    assert client.push("woosh.robot.Battery", lambda body: body["power"] > charging["power"])
    assert client.ask(STATE)["state"] == 8
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    assert client.ask("woosh.robot.Battery")["chargeState"] == 1


def test_an_empty_battery_moves_nothing(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(ABNORMAL)
    simulator.call(lambda s: setattr(s.chassis.battery, "level", 0.0))
    assert [each["msg"] for each in client.push(ABNORMAL)["scs"]] == ["battery low"]
    assert client.refused(*TASK) == "battery is empty: charge first"
    assert client.refused("woosh.robot.Twist", {"linear": 0.2}) == "battery is empty: charge first"
    assert client.ask(STATE)["state"] == 5


def test_fifty_status_codes_are_kept(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe("woosh.robot.count.StatusCode")
    for _ in range(60):
        simulator.set_emergency_stop(True)
        simulator.set_emergency_stop(False)
    pushed = client.taken("woosh.robot.count.StatusCode")
    assert len(pushed) == 60
    assert client.ask(CODES)["scs"] == pushed[-50:]
    assert client.ask("woosh.robot.RobotInfo")["statusCodes"]["scs"] == pushed[-50:]
    assert client.ask("woosh.robot.count.StatusCode") == pushed[-1]


def test_twist_must_be_repeated(client: JsonClient) -> None:
    """It drives on with each one, and slows down half a second after the last."""
    client.subscribe("woosh.robot.PoseSpeed")
    sent = [client.request("woosh.robot.Twist", {"linear": 0.3})["timestamp"] for _ in range(20)]
    speeds: dict[int, float] = {}
    while not any(stamp > sent[-1] and not speed for stamp, speed in speeds.items()):
        frame = client.receive() if not client.pushes else client.pushes.popleft()
        speeds[frame["timestamp"]] = round(frame["body"]["twist"]["linear"], 6)
    assert max(speeds.values()) == 0.3
    speed = 0.0
    for stamp, found in sorted(speeds.items()):  # every 50 ms while it moves
        driven = any(0 < stamp - each <= 500 for each in sent)
        speed = min(speed + 0.05, 0.3) if driven else max(speed - 0.05, 0.0)
        assert found == pytest.approx(speed, abs=1e-6), stamp - sent[-1]


def test_an_explicit_zero_stops_at_once(simulator: SimulatorThread, client: JsonClient) -> None:
    def stop_while_it_drives(simulator: SimulatedChassis) -> tuple[bool, Velocity]:
        # Without the clock, which runs the command into its timeout.
        chassis = simulator.chassis
        dispatch(chassis, Twist(linear=0.5, angular=0.5))
        for _ in range(5):
            chassis.tick(TIME_STEP)
        moving = chassis.base.moving
        dispatch(chassis, Twist())
        return moving, chassis.base.velocity

    client.subscribe("woosh.robot.PoseSpeed")
    assert simulator.call(stop_while_it_drives) == (True, STANDSTILL)
    assert client.push("woosh.robot.PoseSpeed")["twist"] == {"linear": 0.0, "angular": 0.0}


@pytest.mark.parametrize("omnidirectional", [True, False])
def test_only_an_omnidirectional_base_moves_sideways(omnidirectional: bool) -> None:
    config = SimulatorConfig(port=0, tcp_port=0, speed=50, seed=1, omnidirectional=omnidirectional)
    lateral = {"mode": 3, "value": 0.5}
    diagonal = {"mode": 4, "value": 0.5, "angle": 0.5}
    with SimulatorThread(config) as simulator:
        client = JsonClient(simulator.port)
        assert client.ask("woosh.robot.General")["driverMethod"] == int(omnidirectional)
        mileage = simulator.state.odometer
        requests: list[tuple[str, Json]] = [
            ("woosh.robot.Twist", {"linearY": 0.3}),
            ("woosh.ros.CallAction", {"stepControl": {"action": 1, "steps": [lateral]}}),
            ("woosh.ros.CallAction", {"stepControl": {"action": 1, "steps": [diagonal]}}),
        ]
        for name, body in requests:
            if omnidirectional:
                client.ask(name, body)
                pass_time(simulator, 5.0)
            else:
                assert "a differential base cannot move sideways" in client.refused(name, body)
        driven = simulator.state.odometer - mileage
        assert (driven > 1.0) is omnidirectional
        assert client.ask("woosh.robot.PoseSpeed")["mileage"] == int(mileage + driven)
        client.close()


def test_an_empty_battery_is_charged_from_outside_only(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    simulator.call(lambda simulator: setattr(simulator.chassis.battery, "level", 0.0))
    pass_time(simulator, 0.1)
    assert client.refused(*TASK) == "battery is empty: charge first"
    simulator.call(lambda simulator: setattr(simulator.chassis.battery, "level", 50.0))
    pass_time(simulator, 0.1)
    client.ask(*TASK)
