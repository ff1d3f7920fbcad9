"""What the chassis does of its own accord: charging, and parking."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.simulator.sim_wire import Json, JsonClient, pass_time
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread

PROC = "woosh.robot.TaskProc"
INIT, READY, EXECUTING, COMPLETED, CANCELED = 1, 2, 3, 7, 8
PARKING, CHARGE = 2, 3
CHARGE_AFTER_S, PARK_AFTER_S = 10.0, 30.0


@pytest.fixture
def simulator() -> Iterator[SimulatorThread]:
    config = SimulatorConfig(
        port=0,
        tcp_port=0,
        speed=50,
        seed=1,
        charge_after=CHARGE_AFTER_S,
        park_after=PARK_AFTER_S,
    )
    with SimulatorThread(config) as simulator:
        yield simulator


@pytest.fixture(autouse=True)
def _subscribed(client: JsonClient) -> None:
    client.subscribe(PROC)


def drain(simulator: SimulatorThread, level: float = 15.0) -> None:
    simulator.call(lambda s: setattr(s.chassis.battery, "level", level))


def begun(client: JsonClient) -> Json:
    return client.push(PROC, lambda body: body["state"] == EXECUTING)


def test_it_charges_when_the_battery_is_low_and_parks_afterwards(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    levels = {"alarm": 5, "low": 20, "idle": 20, "full": 21}
    client.ask("woosh.robot.setting.Power", levels)
    drain(simulator, 19.6)
    reports = [client.push(PROC)]
    while reports[-1]["state"] != COMPLETED:
        reports.append(client.push(PROC))
    assert {(each["type"], each["dest"]) for each in reports} == {(CHARGE, "C1")}
    assert [each["state"] for each in reports][:3] == [INIT, READY, EXECUTING]
    assert client.ask("woosh.robot.Battery")["power"] == 21
    parking = begun(client)
    assert (parking["type"], parking["dest"]) == (PARKING, "P1")
    assert client.ask("woosh.robot.RobotState")["state"] == 3
    assert client.push(PROC, lambda body: body["state"] == COMPLETED)
    assert simulator.state.pose.distance((10.5, -8.5)) < 0.01
    # There it stays.
    pass_time(simulator, 3 * PARK_AFTER_S)
    assert client.taken(PROC) == []


def test_it_stays_where_it_is_unless_that_is_allowed(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    client.ask("woosh.robot.setting.AutoCharge", {"allow": False})
    client.ask("woosh.robot.setting.AutoPark", {"allow": False})
    drain(simulator)
    pass_time(simulator, 3 * PARK_AFTER_S)
    assert client.taken(PROC) == []
    client.ask("woosh.robot.setting.AutoCharge", {"allow": True})
    assert begun(client)["type"] == CHARGE
    client.ask("woosh.robot.setting.AutoCharge", {"allow": False})
    end = client.push(PROC)
    assert (end["state"], end["msg"]) == (CANCELED, "automatic charging is no longer allowed")


@pytest.mark.parametrize(
    ("busy", "idle"),
    [
        (
            ("woosh.robot.SwitchControlMode", {"mode": 2}),
            ("woosh.robot.SwitchControlMode", {"mode": 1}),
        ),
        (("woosh.robot.SwitchWorkMode", {"mode": 3}), ("woosh.robot.SwitchWorkMode", {"mode": 2})),
        (("woosh.robot.SetOccupancy", {"occupy": True}), ("woosh.robot.SetOccupancy", {})),
        (("woosh.robot.Follow", {"type": True}), ("woosh.robot.Follow", {})),
    ],
)
def test_it_leaves_a_robot_alone_that_somebody_uses(
    simulator: SimulatorThread,
    client: JsonClient,
    busy: tuple[str, Json],
    idle: tuple[str, Json],
) -> None:
    client.ask(*busy)
    drain(simulator)
    pass_time(simulator, 3 * PARK_AFTER_S)
    assert client.taken(PROC) == []
    client.ask(*idle)
    assert begun(client)["type"] == CHARGE


def test_it_leaves_a_paused_task_alone(simulator: SimulatorThread, client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "markNo": "A23"})
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    client.taken(PROC)
    drain(simulator)
    pass_time(simulator, 3 * PARK_AFTER_S)
    assert client.taken(PROC) == []


def test_commands_put_it_off(simulator: SimulatorThread, client: JsonClient) -> None:
    # Slowly: a command has to come in time, and a second is long enough even for a busy machine.
    simulator.call(lambda s: setattr(s, "speed", 4.0))
    drain(simulator)
    since = simulator.state.elapsed
    while simulator.state.elapsed < since + 1.5 * CHARGE_AFTER_S:
        client.ask("woosh.robot.Twist")  # as a joystick does that nobody touches
    assert client.taken(PROC) == []


def test_a_task_of_a_client_replaces_it(simulator: SimulatorThread, client: JsonClient) -> None:
    drain(simulator)
    errand = begun(client)
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "markNo": "A2"})
    end = client.push(PROC)
    assert (end["robotTaskId"], end["state"]) == (errand["robotTaskId"], CANCELED)
    assert end["msg"] == "replaced by task 5"
    assert client.push(PROC, lambda body: body["state"] == COMPLETED)["robotTaskId"] == "5"


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("woosh.robot.Twist", {"linear": 0.2}),
        ("woosh.robot.Twist", {}),
        ("woosh.robot.Follow", {"type": True}),
        (
            "woosh.ros.CallAction",
            {"stepControl": {"action": 1, "steps": [{"mode": 2, "value": 1}]}},
        ),
    ],
)
def test_whatever_a_client_drives_replaces_it(
    simulator: SimulatorThread, client: JsonClient, name: str, body: Json
) -> None:
    drain(simulator)
    begun(client)
    client.ask(name, body)
    end = client.push(PROC)
    assert end["state"] == CANCELED
    assert end["msg"].startswith(("replaced by", "stopped by"))


def test_an_emergency_stop_ends_it(simulator: SimulatorThread, client: JsonClient) -> None:
    drain(simulator)
    begun(client)
    simulator.set_emergency_stop(True)
    end = client.push(PROC)
    assert (end["state"], end["msg"]) == (CANCELED, "emergency stop is pressed")
    simulator.set_emergency_stop(False)
    assert begun(client)["type"] == CHARGE


def test_a_client_can_cancel_it(simulator: SimulatorThread, client: JsonClient) -> None:
    drain(simulator)
    begun(client)
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    assert client.push(PROC)["state"] == CANCELED


def test_a_map_without_a_charger_keeps_it_where_it_is(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    client.ask("woosh.robot.SwitchMap", {"sceneName": "scenex", "mapName": "scenex2"})
    drain(simulator)
    pass_time(simulator, 3 * PARK_AFTER_S)
    assert client.taken(PROC) == []


@pytest.mark.parametrize("after", [{"charge_after": 0.0}, {"park_after": -1.0}])
def test_a_delay_must_be_more_than_none(after: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="more than 0 s"):
        SimulatorConfig(**after)
