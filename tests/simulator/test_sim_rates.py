"""Rates of reports, remote control, and times of answers: the profile tr200."""

from __future__ import annotations

import dataclasses
import statistics
from itertools import pairwise

import pytest

from tests.simulator.real_tasks import exec_task, real_robot, shows
from tests.simulator.recorded_chassis import (
    SteppedChassis,
    answer_times,
    answer_to,
    ask,
    pushed,
    wait_frame,
)
from woosh_robot_agent.simulator.profile import Interval, load_profile

POSE, BATTERY = "woosh.robot.PoseSpeed", "woosh.robot.Battery"
TWIST, UPLOAD = "woosh.robot.Twist", "woosh.map.Upload"
UNINIT, IDLE = 1, 2
EMERGENCY_STOP = 1024
INIT_ROBOT, MODE, INFO = "woosh.robot.InitRobot", "woosh.robot.Mode", "woosh.robot.RobotInfo"
FACTS = real_robot()
RATES, DRIVING = FACTS["rates"], FACTS["driving"]
SPEED = 0.1


def drive(chassis: SteppedChassis, seconds: float) -> None:
    """Send a velocity every 0.1 s."""
    for _ in range(round(seconds / 0.1)):
        chassis.request(TWIST, linear=SPEED)
        chassis.run(0.1)


def test_pose_is_pushed_at_its_rate_while_the_robot_moves(real: SteppedChassis) -> None:
    exec_task(real)
    real.run(8.0)
    times = [frame.time for frame in pushed(real, POSE)]
    assert len(times) > 20
    periods = [after - before for before, after in pairwise(times)]
    assert periods == [pytest.approx(RATES["PoseSpeed while moving"], rel=0.02)] * len(periods)


def test_pushed_pose_is_that_of_the_time_of_the_push(real: SteppedChassis) -> None:
    """Also between two steps of the motion."""
    drive(real, 5.0)
    found = pushed(real, POSE)[3:]
    for before, after in pairwise(found):
        moved = [after.body["pose"][axis] - before.body["pose"][axis] for axis in ("x", "y")]
        distance = (moved[0] ** 2 + moved[1] ** 2) ** 0.5
        assert distance == pytest.approx(SPEED * (after.time - before.time), rel=0.01)


def test_robot_that_stands_pushes_no_pose(real: SteppedChassis) -> None:
    drive(real, 1.0)
    real.run(3.0)
    assert pushed(real, POSE)[-1].body["twist"] == {"linear": 0.0, "angular": 0.0}
    count = len(pushed(real, POSE))
    real.run(60.0)
    assert len(pushed(real, POSE)) == count


@pytest.mark.parametrize("phase", [0.0, 0.03, 0.049])
def test_first_motion_comes_after_the_velocity(real: SteppedChassis, phase: float) -> None:
    real.run(1.0)
    real.chassis.run_until(1.0 + phase)
    drive(real, 1.0)
    first = pushed(real, POSE)[0].time - (1.0 + phase)
    assert first == pytest.approx(DRIVING["velocity to first motion"], rel=0.2)


def test_velocity_that_is_stopped_at_once_moves_nothing(real: SteppedChassis) -> None:
    real.request(TWIST, linear=0.5)
    real.run(0.1)
    real.request(TWIST)
    real.run(2.0)
    assert not pushed(real, POSE)


@pytest.mark.parametrize("zeros", [1, 60])
@pytest.mark.parametrize("phase", [0.0, 0.02, 0.049])
def test_robot_rolls_on_after_velocities_of_zero(
    real: SteppedChassis, phase: float, zeros: int
) -> None:
    drive(real, 3.0)
    stepped = real.chassis.elapsed
    real.chassis.run_until(stepped + phase)
    stopped, place = real.chassis.elapsed, real.chassis.pose
    for _ in range(zeros):
        real.request(TWIST)
        real.run(0.05)
    real.run(3.0)
    least, most = DRIVING["roll after a velocity of zero"]
    assert least - 1e-4 <= place.distance(real.chassis.pose.point) <= most + 1e-4
    last = pushed(real, POSE)[-1].time - stopped
    assert last == pytest.approx(DRIVING["velocity of zero to last change of the pose"], rel=0.2)


def test_roll_is_limited_by_the_brakes_at_high_speed(real: SteppedChassis) -> None:
    for _ in range(30):
        real.request(TWIST, linear=1.0)
        real.run(0.1)
    real.request(TWIST)
    real.run(0.05)
    speed = real.chassis.base.velocity.forward
    real.run(0.05)
    assert speed - real.chassis.base.velocity.forward == pytest.approx(0.05)


def test_measured_step_ends_without_rolling_on(real: SteppedChassis) -> None:
    place = real.chassis.pose
    steps = [{"mode": 1, "value": 0.5, "speed": 0.3}]
    ask(real, "woosh.ros.CallAction", stepControl={"action": 1, "steps": steps})
    real.run(6.0)
    assert place.distance(real.chassis.pose.point) == pytest.approx(0.5, abs=2e-3)


def test_unchanged_battery_is_pushed_again() -> None:
    profile = load_profile("tr200")
    assert list(profile.rates.battery or ()) == RATES["Battery"]
    rates = dataclasses.replace(profile.rates, battery=Interval(5.0, 6.0))
    chassis = SteppedChassis(profile=dataclasses.replace(profile, rates=rates))
    chassis.chassis.battery.level = 50.5
    chassis.run(1.0)
    start = len(pushed(chassis, BATTERY))
    chassis.run(40.0)
    times = [frame.time for frame in pushed(chassis, BATTERY)[start:]]
    periods = [after - before for before, after in pairwise(times)]
    assert len(periods) >= 5
    assert all(5.0 <= period <= 6.06 for period in periods), periods


def test_battery_is_pushed_when_it_changes(real: SteppedChassis) -> None:
    real.run(1.0)
    real.chassis.battery.level -= 5.0
    real.run(0.1)
    (push,) = pushed(real, BATTERY)
    values = {key: value for key, value in push.body.items() if key not in ("power", "robotId")}
    assert values == {
        "chargeState": 1,
        "health": 1,
        "chargeCycle": 16,
        "batteryCycle": 2000,
        "tempMax": 27,
    }


def test_answers_take_as_long_as_those_of_the_real_robot() -> None:
    answers = load_profile("tr200").answers
    for name, times in FACTS["answers"].items():
        assert list(answers.requests.get(name, answers.default)) == times, name
    median, usual, longest = FACTS["answers"][UPLOAD]
    found = answer_times(UPLOAD, 150)
    assert statistics.median(found) == pytest.approx(median, rel=0.2, abs=0.005)
    assert found[int(0.9 * len(found))] == pytest.approx(usual, rel=0.4, abs=0.02)
    assert found[-1] <= longest
    # A velocity is answered as over a radio link.
    median = FACTS["median_answers"]["woosh.robot.Twist"]
    assert statistics.median(answer_times("woosh.robot.Twist", 30)) == pytest.approx(
        median, rel=0.2
    )


def test_init_robot_answers_when_it_is_done(real: SteppedChassis) -> None:
    sent = real.chassis.elapsed
    answer = ask(real, INIT_ROBOT, isRecord=True)
    assert answer.time - sent == pytest.approx(FACTS["median_answers"][INIT_ROBOT], rel=0.2)
    uninit, idle = (wait_frame(real, shows(state)) for state in (UNINIT, IDLE))
    assert uninit.time - sent <= FACTS["times"]["InitRobot to kUninit"][1]
    least, most = FACTS["times"]["InitRobot to kIdle"]
    assert least <= idle.time - sent <= most


def test_robot_refuses_tasks_until_it_is_initialised() -> None:
    chassis = SteppedChassis(initialised=False)
    chassis.request(INIT_ROBOT, isRecord=True)
    chassis.run(3.0)
    assert answer_to(chassis, "woosh.robot.ExecTask", taskId="1", type=1, markNo="A2").ok is False
    chassis.run(3.0)
    ask(chassis, "woosh.robot.ExecTask", taskId="1", type=1, markNo="A2")


def test_second_initialisation_replaces_the_first_one(real: SteppedChassis) -> None:
    real.request(INIT_ROBOT, isRecord=True)
    real.run(3.0)
    second = real.chassis.elapsed
    ask(real, INIT_ROBOT, isRecord=True)
    idle = wait_frame(real, shows(IDLE))
    assert idle.time - second >= FACTS["times"]["InitRobot to kIdle"][0]


def test_waiting_answer_delays_no_other_request(real: SteppedChassis) -> None:
    slow = real.request(INIT_ROBOT, isRecord=True)
    real.run(0.5)
    quick = real.request(MODE)
    real.run(1.0)
    assert [frame.sn for frame in real.frames if frame.sn] == [quick]
    real.run(5.0)
    assert [frame.sn for frame in real.frames if frame.sn] == [quick, slow]


def test_query_is_answered_with_the_value_at_that_time() -> None:
    """Otherwise an answer could hold an older value than a push before it."""
    late = 0
    for seed in range(30):
        chassis = SteppedChassis(seed=seed)
        sn = chassis.request(INFO)
        chassis.chassis.set_emergency_stop(True)
        answer = wait_frame(chassis, lambda frame, sn=sn: frame.sn == sn)
        if answer.time > 0.0:
            late += 1
            assert answer.body["deviceState"]["hardware"] == EMERGENCY_STOP
    assert late > 5
