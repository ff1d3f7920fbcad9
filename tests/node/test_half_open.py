"""A half-open link, with default timeouts: every call and goal ends."""

from __future__ import annotations

import re

import pytest

from tests.harness import Robot, wait_future, wait_until
from tests.node.goals import EXEC_TASK, EXECUTING, lift3, slow_down, task
from tests.node.test_services_load import speak

SPEAK = "woosh.robot.Speak"
NOTICED = 10.0
"""Documented time after which a silent link counts as lost, in seconds."""


@pytest.mark.timeout(600)
def test_a_half_open_link_is_noticed_and_reported(robot: Robot) -> None:
    slow_down(robot.chassis)
    goals = [lift3(robot, 0.4, speed=0.001), task(robot, mark="A23")]
    goals[1].feedback.wait(lambda fb: fb.state.value == EXECUTING)
    goals[0].feedback.wait_count(1)
    assert wait_future(speak(robot, "before")).ok
    injection = robot.chassis.inject("half_open")
    call = speak(robot, "during")
    chassis = robot.link
    wait_until(lambda: chassis.state.value != "ready", "the loss to be noticed")
    silence = re.search(r"nothing was heard for ([0-9.]+) s", str(chassis.last_error))
    assert silence
    assert float(silence[1]) <= NOTICED

    answer = wait_future(call)
    assert not answer.ok
    assert "whether it took effect is not known" in answer.msg
    for goal in goals:
        goal.wait_aborted("link was lost")
    late = wait_future(speak(robot, "late"))
    assert not late.ok
    assert "not connected" in late.msg

    injection.clear()
    wait_until(lambda: wait_future(speak(robot, "after")).ok, "the service")
    texts = [each.message.text for each in robot.chassis.received if each.type == SPEAK]
    assert set(texts) <= {"before", "during", "after"}
    assert texts.count("during") <= 1
    assert robot.chassis.counts[EXEC_TASK] == 1
