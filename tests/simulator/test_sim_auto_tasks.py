"""Automatic charging and parking."""

from __future__ import annotations

import pytest

from tests.quick_chassis import quick_config
from tests.simulator.sim_wire import Json, JsonClient, pass_time

PROC = "woosh.robot.TaskProc"
INIT, READY, EXECUTING, COMPLETED, CANCELED = 1, 2, 3, 7, 8
PARKING, CHARGE = 2, 3
CHARGE_AFTER, PARK_AFTER = 10.0, 30.0  # simulated seconds

pytestmark = pytest.mark.chassis(charge_after=CHARGE_AFTER, park_after=PARK_AFTER)


@pytest.fixture(autouse=True)
def _subscribed(client: JsonClient) -> None:
    client.subscribe(PROC)


def set_battery(client: JsonClient, level: float = 15.0) -> None:
    client.simulator.call(lambda s: setattr(s.chassis.battery, "level", level))


def next_started_task(client: JsonClient) -> Json:
    return client.next_push(PROC, lambda body: body["state"] == EXECUTING)


def test_robot_charges_when_the_battery_is_low_then_parks(client: JsonClient) -> None:
    levels = {"alarm": 5, "low": 20, "idle": 20, "full": 21}
    client.ask("woosh.robot.setting.Power", levels)
    set_battery(client, 19.6)
    reports = [client.next_push(PROC)]
    while reports[-1]["state"] != COMPLETED:
        reports.append(client.next_push(PROC))
    assert {(each["type"], each["dest"]) for each in reports} == {(CHARGE, "C1")}
    assert [each["state"] for each in reports][:3] == [INIT, READY, EXECUTING]
    assert client.ask("woosh.robot.Battery")["power"] == 21
    parking = next_started_task(client)
    assert (parking["type"], parking["dest"]) == (PARKING, "P1")
    assert client.ask("woosh.robot.RobotState")["state"] == 3
    assert client.next_push(PROC, lambda body: body["state"] == COMPLETED)
    assert client.simulator.state.pose.distance((10.5, -8.5)) < 0.01
    # It stays there.
    pass_time(client.simulator, 3 * PARK_AFTER)
    assert client.take_pushes(PROC) == []


def test_robot_with_a_low_battery_parks_if_the_map_has_no_charger(client: JsonClient) -> None:
    client.ask("woosh.map.mark.storage.Delete", {"no": "C1"})
    set_battery(client)
    assert next_started_task(client)["type"] == PARKING


def test_no_automatic_task_starts_unless_it_is_allowed(client: JsonClient) -> None:
    client.ask("woosh.robot.setting.AutoCharge", {"allow": False})
    client.ask("woosh.robot.setting.AutoPark", {"allow": False})
    set_battery(client)
    pass_time(client.simulator, 3 * PARK_AFTER)
    assert client.take_pushes(PROC) == []
    client.ask("woosh.robot.setting.AutoCharge", {"allow": True})
    assert next_started_task(client)["type"] == CHARGE
    client.ask("woosh.robot.setting.AutoCharge", {"allow": False})
    end = client.next_push(PROC)
    assert (end["state"], end["msg"]) == (CANCELED, "automatic charging is no longer allowed")


@pytest.mark.parametrize(
    ("name", "begin", "end"),
    [
        ("SwitchControlMode", {"mode": 2}, {"mode": 1}),
        ("SwitchWorkMode", {"mode": 3}, {"mode": 2}),
        ("SetOccupancy", {"occupy": True}, {}),
        ("Follow", {"type": True}, {}),
        ("SwitchMap", {"mapName": "scenex2"}, {"mapName": "wooshmap"}),  # one without marks
    ],
)
def test_no_automatic_task_starts_while_the_robot_is_in_use_or_has_no_mark(
    client: JsonClient, name: str, begin: Json, end: Json
) -> None:
    client.ask(f"woosh.robot.{name}", begin)
    set_battery(client)
    pass_time(client.simulator, 3 * PARK_AFTER)
    assert client.take_pushes(PROC) == []
    client.ask(f"woosh.robot.{name}", end)
    assert next_started_task(client)["type"] == CHARGE


def test_no_automatic_task_replaces_a_paused_task(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "markNo": "A23"})
    client.ask("woosh.robot.ActionOrder", {"order": 2})
    client.take_pushes(PROC)
    set_battery(client)
    pass_time(client.simulator, 3 * PARK_AFTER)
    assert client.take_pushes(PROC) == []


def test_velocity_commands_postpone_automatic_tasks(client: JsonClient) -> None:
    # Slow, so that even a busy machine sends the next command before the delay ends.
    client.simulator.call(lambda s: setattr(s, "speed", 4.0))
    set_battery(client)
    since = client.simulator.state.elapsed
    while client.simulator.state.elapsed < since + 1.5 * CHARGE_AFTER:
        client.ask("woosh.robot.Twist")  # an untouched joystick sends zeros too
    assert client.take_pushes(PROC) == []


def test_client_task_replaces_an_automatic_task(client: JsonClient) -> None:
    set_battery(client)
    charging = next_started_task(client)
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "markNo": "A2"})
    end = client.next_push(PROC)
    assert (end["robotTaskId"], end["state"]) == (charging["robotTaskId"], CANCELED)
    assert end["msg"] == "replaced by task 5"
    assert client.next_push(PROC, lambda body: body["state"] == COMPLETED)["robotTaskId"] == "5"


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
        ("woosh.robot.ActionOrder", {"order": 4}),
    ],
)
def test_client_motion_or_cancel_ends_an_automatic_task(
    client: JsonClient, name: str, body: Json
) -> None:
    set_battery(client)
    next_started_task(client)
    client.ask(name, body)
    end = client.next_push(PROC)
    assert end["state"] == CANCELED
    assert end["msg"].startswith(("replaced by", "stopped by", "cancelled"))


def test_zero_twist_says_that_it_has_cancelled_an_automatic_task(client: JsonClient) -> None:
    set_battery(client)
    task = next_started_task(client)["robotTaskId"]
    answer = client.request("woosh.robot.Twist")
    assert (answer["ok"], answer["msg"]) == (True, f"stopped: task {task} is cancelled")


def test_emergency_stop_cancels_an_automatic_task(client: JsonClient) -> None:
    set_battery(client)
    next_started_task(client)
    client.simulator.set_emergency_stop(True)
    end = client.next_push(PROC)
    assert (end["state"], end["msg"]) == (CANCELED, "emergency stop is pressed")
    client.simulator.set_emergency_stop(False)
    assert next_started_task(client)["type"] == CHARGE


@pytest.mark.parametrize("after", [{"charge_after": 0.0}, {"park_after": -1.0}])
def test_delays_must_be_positive(after: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="more than 0 s"):
        quick_config(**after)
