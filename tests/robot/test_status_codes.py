"""Status codes: their meaning, and their log."""

from __future__ import annotations

import logging
import re
from typing import Any

import pytest

from tests.fact_files import FOLDER
from tests.robot.rig import READY, Rig, StoppedClock
from woosh_robot_agent.link import reports
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.robot import code_log
from woosh_robot_agent.robot.status_codes import explained, meaning


def test_every_known_code_has_its_meaning():
    text = (FOLDER / "status_codes.yaml").read_text("utf-8")
    table = re.findall(r'^(\d{12}): "(.+)"$', text, re.M)
    assert len(table) == 816
    for code, expected in table:
        assert meaning(int(code)) == expected


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (110202000012, "safety bumper 1 was hit"),  # as a robot logged it; the table has ...13
        (130104000030, ""),  # ...31 and ...32 mean the opposite of each other
        (999999999999, ""),
        (0, ""),
        (-1, ""),
    ],
)
def test_a_code_with_another_level_has_a_meaning_if_it_is_the_only_one(code, expected):
    assert meaning(code) == expected


@pytest.mark.parametrize(
    ("code", "text", "expected"),
    [
        (110201000013, "", "110201000013: emergency stop 1 was pressed"),
        (110201000013, "急停1按下", "110201000013: 急停1按下 (emergency stop 1 was pressed)"),
        (
            110201000013,
            "Emergency stop 1 was pressed",
            "110201000013: Emergency stop 1 was pressed",
        ),
        (999999999999, "something", "999999999999: something"),
        (999999999999, "", "999999999999: unknown code"),
    ],
)
def test_a_code_is_explained_beside_its_own_text(code, text, expected):
    assert explained(code, text) == expected


PRESSED = {"code": "110201000013", "level": 3}
HOT = {"code": 110301000042, "level": 2, "msg": "左电机过热"}


def logged(caplog: pytest.LogCaptureFixture) -> list[tuple[int, str]]:
    return [
        (record.levelno, record.getMessage().removeprefix("the robot reports "))
        for record in caplog.records
        if record.name == code_log.__name__ and record.levelno >= logging.INFO
    ]


async def test_warnings_and_faults_are_logged_with_their_meaning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with Rig(READY).running() as rig:
        await rig.push(StatusCode(), PRESSED)
        await rig.push(StatusCode(), HOT)
    assert logged(caplog) == [
        (logging.ERROR, "110201000013: emergency stop 1 was pressed"),
        (logging.WARNING, "110301000042: 左电机过热 (left motor is too hot)"),
    ]


async def test_other_levels_are_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    levels: tuple[Any, ...] = ({}, {"level": 0}, {"level": 1}, {"level": "kTips"})
    async with Rig(READY).running() as rig:
        for level in levels:
            await rig.push(StatusCode(), {"code": "130103000000", **level})
    assert logged(caplog) == []


async def test_a_burst_of_one_code_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    async with Rig(READY).running() as rig:
        for _ in range(300):
            await rig.wire.push("woosh.robot.count.StatusCode", PRESSED)
        await rig.push(AbnormalCodes(), {"scs": [PRESSED]})
        await rig.push(StatusCode(), HOT)
    assert [text[:12] for _, text in logged(caplog)] == ["110201000013", "110301000042"]


async def test_a_code_that_comes_back_is_logged_again(caplog: pytest.LogCaptureFixture) -> None:
    async with Rig({**READY, "abnormalCodes": {"scs": [PRESSED]}}).running() as rig:
        await rig.push(StatusCode(), PRESSED)
        assert len(logged(caplog)) == 1
        await rig.push(AbnormalCodes(), {})
        await rig.push(StatusCode(), PRESSED)
    assert len(logged(caplog)) == 2


async def test_a_code_that_lasts_is_not_repeated_but_an_event_is_after_a_while(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = StoppedClock(monkeypatch, reports)
    async with Rig({**READY, "abnormalCodes": {"scs": [PRESSED]}}).running() as rig:
        await rig.push(StatusCode(), HOT)
        clock.now += code_log.QUIET + 1
        await rig.push(StatusCode(), PRESSED)
        await rig.push(StatusCode(), HOT)
    assert [text[:12] for _, text in logged(caplog)] == [
        "110201000013",
        "110301000042",
        "110301000042",
    ]
