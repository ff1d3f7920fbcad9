"""Times from requests to their answers: the profile tr200."""

from __future__ import annotations

import statistics

import pytest

from tests.simulator.real_tasks import real_robot, shows
from tests.simulator.recorded_chassis import SteppedChassis, answer_to, ask, wait_frame
from woosh_robot_agent.simulator.profile import load_profile

UNINIT, IDLE = 1, 2
EMERGENCY_STOP = 1024
FACTS = real_robot()
INIT_ROBOT, MODE, INFO = "woosh.robot.InitRobot", "woosh.robot.Mode", "woosh.robot.RobotInfo"
UPLOAD = "woosh.map.Upload"


def answer_times(type_name: str, count: int) -> list[float]:
    """Return the times of the answers to `count` requests one after another, shortest first."""
    chassis = SteppedChassis()
    found = []
    for _ in range(count):
        sent = chassis.chassis.elapsed
        found.append(answer_to(chassis, type_name).time - sent)  # accepted or refused
    return sorted(found)


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
