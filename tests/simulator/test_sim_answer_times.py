"""Times from requests to their answers: the profile tr200."""

from __future__ import annotations

import statistics
import time

import pytest

from tests.simulator.real_tasks import real_robot, shows
from tests.simulator.recorded_chassis import (
    SteppedChassis,
    answer_times,
    answer_to,
    ask,
    wait_frame,
)
from tests.simulator.sim_wire import JsonClient

UNINIT, IDLE = 1, 2
EMERGENCY_STOP = 1024
FACTS = real_robot()
INIT_ROBOT, MODE, INFO = "woosh.robot.InitRobot", "woosh.robot.Mode", "woosh.robot.RobotInfo"
SAMPLES = 150


@pytest.mark.parametrize("type_name", FACTS["answers"])
def test_answers_take_as_long_as_those_of_the_real_robot(type_name: str) -> None:
    median, usual, longest = FACTS["answers"][type_name]
    found = answer_times(type_name, SAMPLES)
    assert statistics.median(found) == pytest.approx(median, rel=0.2, abs=0.005)
    assert found[int(0.9 * len(found))] == pytest.approx(usual, rel=0.4, abs=0.02)
    assert found[-1] <= longest


def test_twist_is_answered_as_over_a_radio_link() -> None:
    median = FACTS["median_answers"]["woosh.robot.Twist"]
    found = answer_times("woosh.robot.Twist", SAMPLES)
    assert statistics.median(found) == pytest.approx(median, rel=0.2)


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


@pytest.mark.chassis(speed=5, profile="tr200")
def test_answers_arrive_after_their_time_over_a_socket(client: JsonClient) -> None:
    """The order of the answers over a real socket, and their times by its clock, at least."""
    client.send({"type": INIT_ROBOT, "body": {"isRecord": True}, "sn": 901})
    started = time.monotonic()
    stamp = client.request(MODE)["timestamp"]
    answer = client.receive()
    while answer.get("sn") != 901:
        answer = client.receive()
    least = FACTS["times"]["InitRobot to kIdle"][0]
    assert (answer["timestamp"] - stamp) / 1000 > 0.9 * least
    assert time.monotonic() - started > 0.9 * least / 5
