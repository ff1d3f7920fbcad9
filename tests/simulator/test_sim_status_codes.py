"""Status codes: which ones the simulated robot sends, with which texts, and when."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.simulator.sim_wire import JsonClient, connected
from woosh_robot_agent.simulator import status_codes

CODES = [each for each in vars(status_codes).values() if isinstance(each, status_codes.Code)]
FACTS = Path(__file__).parents[1] / "facts/status_codes.yaml"
_LINE = re.compile(r'^(\d{12}): "(.+)"$', re.M)
TABLE = {int(code): text for code, text in _LINE.findall(FACTS.read_text("utf-8"))}
ABNORMAL, CODE = "woosh.robot.count.AbnormalCodes", "woosh.robot.count.StatusCode"
EMERGENCY_STOP = 110201000013
TEXTS = {"zh": "急停1按下", "en": "emergency stop 1 was pressed", "none": ""}


def test_every_code_is_in_the_table_of_real_robots() -> None:
    for code in CODES:
        assert code.text("en") == TABLE[code.number]
        assert code.level == code.number % 10, code
        assert re.search("[\u4e00-\u9fff]", code.text("zh")), code
        assert code.text("none") == "", code


@pytest.mark.parametrize(
    ("options", "language"),
    [({}, "zh"), ({"profile": "instant"}, "en"), ({"code_language": "none"}, "none")],
)
def test_language_of_the_texts(options: dict[str, str], language: str) -> None:
    with connected(**{"profile": "tr200", **options}) as client:
        client.subscribe(CODE)
        client.simulator.inject("emergency_stop")
        pushed = client.next_push(CODE)
        (listed,) = client.ask(ABNORMAL)["scs"]
        for code in (pushed, listed):
            assert (code["code"], code["msg"]) == (str(EMERGENCY_STOP), TEXTS[language])
            assert code["level"] == 3


def test_changes_of_the_control_mode_are_reported(client: JsonClient) -> None:
    client.subscribe(CODE)
    for mode, code in ((3, "140802000071"), (2, "140802000061"), (1, "140802000051")):
        client.ask("woosh.robot.SwitchControlMode", {"mode": mode})
        assert client.next_push(CODE)["code"] == code
    client.simulator.set_key_switch(True)
    assert client.next_push(CODE)["code"] == "140802000061"
    client.simulator.set_key_switch(False)
    assert client.next_push(CODE)["code"] == "140802000051"
    assert client.ask(ABNORMAL)["scs"] == []
