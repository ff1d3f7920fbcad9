"""The commands of docs/maps.md, in the page's order, with two robots."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.harness import Client, Robot, wait_until
from tests.quick_chassis import quick_config
from tests.ros2_commands import parse
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.maps import program as maps

PAGE = Path(__file__).parents[2] / "docs" / "maps.md"
SUCCEEDED = 4


@pytest.fixture
def first() -> Iterator[SimulatorThread]:
    """The robot whose maps are saved. The agent serves the second robot."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, seed=2)) as running:
        yield running


def blocks() -> list[tuple[str, str]]:
    """Return language and content of all examples of the page, in order."""
    return re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(), re.DOTALL)


def set_mark(file: Path, entry: dict[str, Any]) -> None:
    """Replace the mark with the number of `entry`, or add it."""
    content = yaml.safe_load(file.read_text())
    marks = [mark for mark in content["marks"] if mark["number"] != entry["number"]]
    content["marks"] = [*marks, entry]
    file.write_text(yaml.safe_dump(content))


def execute(client: Client, line: str) -> Any:
    """Call a service or send a goal, as a command says; return the response or the result."""
    command = parse(line)
    if command.verb == "service call":
        answer = client.call(command.cls, command.name, arg=command.filled().arg)
        assert answer.ok, f"{line}: {answer.msg}"
        return answer
    assert command.verb == "action send_goal"
    status, result = client.send_goal(command.cls, command.name, command.filled()).result(60.0)
    assert status == SUCCEEDED, f"{line}: {result}"
    return result


def test_the_commands_of_the_page_work_in_its_order(
    first: SimulatorThread,
    robot: Robot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    robots = {"172.20.8.74": first, "172.20.8.75": robot.chassis}
    printed = ""

    def run(line: str) -> None:
        nonlocal printed
        words = shlex.split(line)
        if words[:4] != ["ros2", "run", "woosh_robot_agent", "maps"]:
            execute(robot, line)
            return
        where = ["--ip", f"127.0.0.1:{robots[words[5]].port}"]
        assert maps.main([*where, *words[6:]]) == 0, f"{line}: {capsys.readouterr().err}"
        printed += capsys.readouterr().out

    consoles = 0
    for language, content in blocks():
        if language == "bash":
            for line in content.splitlines():
                run(line)
        elif language == "yaml":
            (entry,) = yaml.safe_load(content)
            set_mark(tmp_path / "backup" / "wooshmap" / "marks" / "wooshmap.yaml", entry)
        elif not content.startswith("$"):
            consoles += 1
            assert printed == content
    assert consoles == 1
    marks = first.call(lambda s: dict(s.chassis.scenes["wooshmap"].maps[0].marks))
    assert (marks["A1"].pose.x, marks["A1"].pose.y) == (-3.0, 5.0)
    assert set(robot.chassis.call(lambda s: list(s.chassis.scenes))) == {"wooshmap", "hall"}
    wait_until(lambda: abs(robot.chassis.state.pose.x - 1.0) < 0.1)
    assert robot.chassis.state.pose.y == pytest.approx(2.0, abs=0.1)
