"""Rates of reports, and remote control: the profile tr200."""

from __future__ import annotations

from itertools import pairwise

import pytest

from tests.simulator.real_tasks import exec_task, real_robot
from tests.simulator.recorded_chassis import SteppedChassis, ask, pushed
from tests.simulator.sim_wire import connected, pass_time

POSE, BATTERY, SCAN = "woosh.robot.PoseSpeed", "woosh.robot.Battery", "woosh.robot.ScannerData"
TWIST = "woosh.robot.Twist"
FACTS = real_robot()
RATES, DRIVING = FACTS["rates"], FACTS["driving"]
SPEED = 0.1


@pytest.fixture
def chassis() -> SteppedChassis:
    return SteppedChassis()


def drive(chassis: SteppedChassis, seconds: float) -> None:
    """Send a velocity every 0.1 s."""
    for _ in range(round(seconds / 0.1)):
        chassis.request(TWIST, linear=SPEED)
        chassis.run(0.1)


def test_pose_is_pushed_at_its_rate_while_the_robot_moves(chassis: SteppedChassis) -> None:
    exec_task(chassis)
    chassis.run(8.0)
    times = [frame.time for frame in pushed(chassis, POSE)]
    assert len(times) > 20
    periods = [after - before for before, after in pairwise(times)]
    assert periods == [pytest.approx(RATES["PoseSpeed while moving"], rel=0.02)] * len(periods)


def test_pushed_pose_is_that_of_the_time_of_the_push(chassis: SteppedChassis) -> None:
    """Also between two steps of the motion."""
    drive(chassis, 5.0)
    found = pushed(chassis, POSE)[3:]
    for before, after in pairwise(found):
        moved = [after.body["pose"][axis] - before.body["pose"][axis] for axis in ("x", "y")]
        distance = (moved[0] ** 2 + moved[1] ** 2) ** 0.5
        assert distance == pytest.approx(SPEED * (after.time - before.time), rel=0.01)


def test_robot_that_stands_pushes_no_pose(chassis: SteppedChassis) -> None:
    drive(chassis, 1.0)
    chassis.run(3.0)
    assert pushed(chassis, POSE)[-1].body["twist"] == {"linear": 0.0, "angular": 0.0}
    count = len(pushed(chassis, POSE))
    chassis.run(60.0)
    assert len(pushed(chassis, POSE)) == count


@pytest.mark.parametrize("phase", [0.0, 0.01, 0.03, 0.049])
def test_first_motion_comes_after_the_velocity(chassis: SteppedChassis, phase: float) -> None:
    chassis.run(1.0)
    chassis.chassis.run_until(1.0 + phase)
    drive(chassis, 1.0)
    first = pushed(chassis, POSE)[0].time - (1.0 + phase)
    assert first == pytest.approx(DRIVING["velocity to first motion"], rel=0.2)


def test_velocity_that_is_stopped_at_once_moves_nothing(chassis: SteppedChassis) -> None:
    chassis.request(TWIST, linear=0.5)
    chassis.run(0.1)
    chassis.request(TWIST)
    chassis.run(2.0)
    assert not pushed(chassis, POSE)


@pytest.mark.parametrize("phase", [0.0, 0.02, 0.049])
def test_robot_rolls_on_after_a_velocity_of_zero(chassis: SteppedChassis, phase: float) -> None:
    drive(chassis, 3.0)
    stepped = chassis.chassis.elapsed
    chassis.chassis.run_until(stepped + phase)
    stopped, place = chassis.chassis.elapsed, chassis.chassis.pose
    chassis.request(TWIST)
    chassis.run(3.0)
    least, most = DRIVING["roll after a velocity of zero"]
    assert least - 1e-4 <= place.distance(chassis.chassis.pose.point) <= most + 1e-4
    last = pushed(chassis, POSE)[-1].time - stopped
    assert last == pytest.approx(DRIVING["velocity of zero to last change of the pose"], rel=0.2)


def test_roll_is_limited_by_the_brakes_at_high_speed(chassis: SteppedChassis) -> None:
    for _ in range(30):
        chassis.request(TWIST, linear=1.0)
        chassis.run(0.1)
    chassis.request(TWIST)
    chassis.run(0.05)
    speed = chassis.chassis.base.velocity.forward
    chassis.run(0.05)
    assert speed - chassis.chassis.base.velocity.forward == pytest.approx(0.05)


def test_measured_step_ends_without_rolling_on(chassis: SteppedChassis) -> None:
    place = chassis.chassis.pose
    steps = [{"mode": 1, "value": 0.5, "speed": 0.3}]
    ask(chassis, "woosh.ros.CallAction", stepControl={"action": 1, "steps": steps})
    chassis.run(6.0)
    assert place.distance(chassis.chassis.pose.point) == pytest.approx(0.5, abs=2e-3)


def test_scans_are_new_at_their_rate(chassis: SteppedChassis) -> None:
    exec_task(chassis)
    chassis.run(4.0)
    changes, last = [], None
    for _ in range(80):
        scan = ask(chassis, SCAN)
        if scan.body["ranges"] != last:
            changes.append(chassis.chassis.elapsed)
            last = scan.body["ranges"]
        chassis.run(0.05)
    periods = [after - before for before, after in pairwise(changes[1:])]
    assert sum(periods) / len(periods) == pytest.approx(RATES["scan"], rel=0.2)


def test_unchanged_battery_is_pushed_again(chassis: SteppedChassis) -> None:
    chassis.chassis.battery.level = 50.0
    chassis.run(1.0)
    start = len(pushed(chassis, BATTERY))
    for _ in range(1600):
        chassis.chassis.battery.level = 50.0
        chassis.run(1.0)
    times = [frame.time for frame in pushed(chassis, BATTERY)[start:]]
    least, most = RATES["Battery"]
    periods = [after - before for before, after in pairwise(times)]
    assert periods
    assert all(least <= period <= most for period in periods), periods


def test_battery_is_pushed_when_it_changes(chassis: SteppedChassis) -> None:
    chassis.run(1.0)
    chassis.chassis.battery.level -= 5.0
    chassis.run(0.1)
    (push,) = pushed(chassis, BATTERY)
    values = {key: value for key, value in push.body.items() if key not in ("power", "robotId")}
    assert values == {
        "chargeState": 1,
        "health": 1,
        "chargeCycle": 16,
        "batteryCycle": 2000,
        "tempMax": 27,
    }


def test_pose_arrives_at_its_rate_over_a_socket() -> None:
    """The stamps of the frames have times between the steps of the motion."""
    with connected(speed=2, profile="tr200") as (simulator, client):
        client.subscribe(POSE)
        client.send(
            {"type": "woosh.robot.ExecTask", "sn": 99, "body": {"type": 1, "markNo": "K10"}}
        )
        pass_time(simulator, 6.0)
        client.ask("woosh.robot.Mode")
    stamps = [frame["timestamp"] for frame in client.pushes if frame["type"] == POSE]
    periods = sorted(after - before for before, after in pairwise(stamps))
    assert len(periods) > 10
    period = 1000 * RATES["PoseSpeed while moving"]
    assert periods[len(periods) // 2] == pytest.approx(period, rel=0.02)
