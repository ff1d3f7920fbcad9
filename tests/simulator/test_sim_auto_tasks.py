"""Automatic charging and parking."""

from __future__ import annotations

from typing import Any

import pytest

from tests.quick_chassis import quick_config
from tests.simulator.recorded_chassis import SteppedChassis, ask, pushed, wait_frame
from tests.simulator.sim_wire import Json

PROC, TWIST = "woosh.robot.TaskProc", "woosh.robot.Twist"
INIT, READY, EXECUTING, COMPLETED, CANCELED = 1, 2, 3, 7, 8
PARKING, CHARGE = 2, 3
CHARGE_AFTER, PARK_AFTER = 5.0, 15.0  # simulated seconds
LOW = 15.0


@pytest.fixture
def chassis() -> SteppedChassis:
    """A chassis with a low battery, which is going to charge."""
    chassis = SteppedChassis(profile="instant", charge_after=CHARGE_AFTER, park_after=PARK_AFTER)
    chassis.chassis.battery.level = LOW
    return chassis


def next_report(chassis: SteppedChassis, state: int) -> Json:
    """Let time pass until a task has this state."""
    start = len(chassis.frames)
    return wait_frame(
        chassis, lambda frame: frame.type == PROC and frame.body["state"] == state, start
    ).body


def assert_no_task_starts(chassis: SteppedChassis) -> None:
    chassis.frames.clear()
    chassis.run(2 * PARK_AFTER)
    assert pushed(chassis, PROC) == []


def test_robot_charges_when_the_battery_is_low_then_parks(chassis: SteppedChassis) -> None:
    levels = {"alarm": 5, "low": 20, "idle": 20, "full": 21}
    ask(chassis, "woosh.robot.setting.Power", **levels)
    chassis.chassis.battery.level = 19.6
    next_report(chassis, COMPLETED)
    reports = [frame.body for frame in pushed(chassis, PROC)]
    assert {(each["type"], each["dest"]) for each in reports} == {(CHARGE, "C1")}
    assert [each["state"] for each in reports][:3] == [INIT, READY, EXECUTING]
    assert ask(chassis, "woosh.robot.Battery").body["power"] == 21
    parking = next_report(chassis, EXECUTING)
    assert (parking["type"], parking["dest"]) == (PARKING, "P1")
    assert ask(chassis, "woosh.robot.RobotState").body["state"] == 3
    next_report(chassis, COMPLETED)
    assert chassis.chassis.pose.distance((10.5, -8.5)) < 0.01
    assert_no_task_starts(chassis)  # it stays there


def test_robot_with_a_low_battery_parks_if_the_map_has_no_charger(chassis: SteppedChassis) -> None:
    ask(chassis, "woosh.map.mark.storage.Delete", no="C1")
    assert next_report(chassis, EXECUTING)["type"] == PARKING


def test_no_automatic_task_starts_unless_it_is_allowed(chassis: SteppedChassis) -> None:
    ask(chassis, "woosh.robot.setting.AutoCharge", allow=False)
    ask(chassis, "woosh.robot.setting.AutoPark", allow=False)
    assert_no_task_starts(chassis)
    ask(chassis, "woosh.robot.setting.AutoCharge", allow=True)
    assert next_report(chassis, EXECUTING)["type"] == CHARGE
    ask(chassis, "woosh.robot.setting.AutoCharge", allow=False)
    end = next_report(chassis, CANCELED)
    assert end["msg"] == "automatic charging is no longer allowed"


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
    chassis: SteppedChassis, name: str, begin: Json, end: Json
) -> None:
    ask(chassis, f"woosh.robot.{name}", **begin)
    assert_no_task_starts(chassis)
    ask(chassis, f"woosh.robot.{name}", **end)
    assert next_report(chassis, EXECUTING)["type"] == CHARGE


def test_neither_a_paused_task_nor_velocities_give_way_to_automatic_tasks(
    chassis: SteppedChassis,
) -> None:
    for _ in range(15):
        ask(chassis, TWIST)  # an untouched joystick sends zeros too
        chassis.run(0.5)
    assert pushed(chassis, PROC) == []
    ask(chassis, "woosh.robot.ExecTask", taskId=5, type=1, markNo="A23")
    ask(chassis, "woosh.robot.ActionOrder", order=2)
    assert_no_task_starts(chassis)


STEPS = {"action": 1, "steps": [{"mode": 2, "value": 1}]}
ENDS: list[tuple[str, dict[str, Any], str]] = [
    ("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "markNo": "A2"}, "replaced by task 5"),
    (TWIST, {"linear": 0.2}, "replaced by"),
    (TWIST, {}, "stopped by"),
    ("woosh.robot.Follow", {"type": True}, "replaced by"),
    ("woosh.ros.CallAction", {"stepControl": STEPS}, "replaced by"),
    ("woosh.robot.ActionOrder", {"order": 4}, "cancelled"),
]
"""Requests that end an automatic task, and the reason that its last report gives."""


def test_client_motion_or_cancel_ends_an_automatic_task() -> None:
    for name, body, reason in ENDS:
        chassis = SteppedChassis(profile="instant", charge_after=CHARGE_AFTER)
        chassis.chassis.battery.level = LOW
        number = next_report(chassis, EXECUTING)["robotTaskId"]
        ask(chassis, name, **body)
        ends = [frame.body for frame in pushed(chassis, PROC) if frame.body["state"] == CANCELED]
        assert [each["robotTaskId"] for each in ends] == [number]
        assert ends[0]["msg"].startswith(reason)
        if (name, body) == (TWIST, {}):
            (answer,) = (frame for frame in chassis.raw if frame["type"] == TWIST)
            assert answer["msg"] == f"stopped: task {number} is cancelled"


def test_emergency_stop_cancels_an_automatic_task(chassis: SteppedChassis) -> None:
    next_report(chassis, EXECUTING)
    chassis.chassis.set_emergency_stop(True)
    end = next_report(chassis, CANCELED)
    assert end["msg"] == "emergency stop is pressed"
    chassis.chassis.set_emergency_stop(False)
    assert next_report(chassis, EXECUTING)["type"] == CHARGE


def test_delays_must_be_positive() -> None:
    for after in ({"charge_after": 0.0}, {"park_after": -1.0}):
        with pytest.raises(ValueError, match="more than 0 s"):
            quick_config(**after)
