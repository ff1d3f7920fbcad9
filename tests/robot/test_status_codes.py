"""Meaning of status codes."""

from __future__ import annotations

import re

import pytest

from tests.fact_files import FOLDER
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
