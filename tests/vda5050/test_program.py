"""The command line of the connector, and the file that lists its robots."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.vda5050 import program
from woosh_robot_agent.vda5050.__main__ import main
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.messages.versions import V3_0
from woosh_robot_agent.vda5050.robots_file import ListedRobot, read_robots
from woosh_robot_agent.vda5050.session import VehicleConfig

ROOT = Path(__file__).resolve().parents[2]


def read(path: Path, text: str, **default: object) -> list[ListedRobot]:
    file = path / "robots.yaml"
    file.write_text(text)
    return read_robots(file, LinkConfig(**default))  # type: ignore[arg-type]


def test_the_agents_own_example_is_read() -> None:
    robots = read_robots(ROOT / "config/robots.yaml", LinkConfig())
    assert [(each.name, each.link.ip, each.link.port) for each in robots] == [
        ("r1", "127.0.0.1", 5480),
        ("r2", "127.0.0.1", 5490),
    ]


def test_the_documented_file_is_read(tmp_path: Path) -> None:
    text = (ROOT / "docs/vda5050.md").read_text()
    (example,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    assert [each.name for each in read(tmp_path, example)] == ["woosh_1", "woosh_2"]


def test_later_sections_override_earlier_ones_and_the_command_line(tmp_path: Path) -> None:
    robots = read(
        tmp_path,
        """
        /**: {ros__parameters: {robots: [hall/r1, r2, r3], ip: gateway, connect_timeout: 20}}
        /hall/*/agent: {ros__parameters: {robot_id: 7}}
        /r2/agent: {ros__parameters: {port: 7, transport: tcp, serial_number: 17}}
        /r3/agent: {ros__parameters: {poll_timeout: 2500}}
        r3: {agent: {ros__parameters: {ip: 10.0.0.3}}}
        /r3/other: {ros__parameters: {ip: 10.0.0.4}}
        """,
        encoding="protobuf",
        request_timeout=4.0,
    )
    timeouts = {"connect_timeout": 20, "handshake_timeout": 20, "request_timeout": 4.0}
    common = {"encoding": "protobuf", **timeouts}
    assert {each.name: each.link for each in robots} == {
        "hall/r1": LinkConfig(ip="gateway", robot_id=7, **common),  # type: ignore[arg-type]
        "r2": LinkConfig(ip="gateway", port=7, transport="tcp", **common),  # type: ignore[arg-type]
        "r3": LinkConfig(ip="10.0.0.3", **common | {"request_timeout": 2.5}),  # type: ignore[arg-type]
    }
    assert robots[1].serial_number == "17"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not a parameter file"),
        (
            "/**: {ros__parameters: {robots: [a], ip: host}}\n"
            "/a/agent: {ros_parameters: {port: 7}}",
            "not a parameter file",
        ),
        ("a: [", "not readable as YAML"),
        ("/**: {ros__parameters: {ip: host}}", "list the names of the robots"),
        ("/**: {ros__parameters: {robots: [a]}}", "robot a: it needs an ip"),
        ("/**: {ros__parameters: {robots: [a], ip: host, port: 99999}}", "robot a: .*port 99999"),
        (
            "/**: {ros__parameters: {robots: [a], ip: host, poll_timeout: soon}}",
            "robot a: its poll_timeout: must be a number",
        ),
        (
            "/**: {ros__parameters: {robots: [a, b], ip: host}}\n"
            "/b/agent: {ros__parameters: {robot_id: 8}}",
            "robot b: it has the address of",
        ),
        ("/**: {ros__parameters: {robots: [a, /a], ip: host}}", "its own name"),
    ],
)
def test_a_wrong_file_is_refused_with_its_reason(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as caught:
        read(tmp_path, text)
    assert "robots.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--broker", "mqtt://host", "--ip", "a", "--robots", "f"], "either --ip or --robots"),
        (["--broker", "http://me:secret@host", "--ip", "a"], "'http://...@host'"),
        (["--broker", "mqtt://me:sec#ret@host", "--ip", "a"], "'mqtt://...@host'"),
        (
            ["--broker", "mqtt://host", "--ip", "a", "--serial-number", "a/b"],
            "the serial number is a part of the topics and cannot have /: 'a/b'",
        ),
        (["--broker", "mqtt://host", "--robots", "/none/f"], "/none/f: No such file"),
        (
            ["--broker", "mqtt://host", "--robots", "f", "--serial-number", "1"],
            "serial_number in the file",
        ),
    ],
)
def test_a_wrong_option_ends_the_program_with_its_reason(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert reason in capsys.readouterr().err


def test_the_options_reach_the_vehicle(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made: list[VehicleConfig] = []

    async def run(connector: object, dashboard_port: int | None) -> int:
        return 0

    monkeypatch.setattr(program, "Connector", lambda vehicles, _: made.extend(vehicles.values()))
    monkeypatch.setattr(program, "_run", run)
    monkeypatch.setattr(program, "log_to_stderr", lambda *arguments: None)
    options = (
        "--broker mqtt://host --ip robot --version 3.0 --interface a/b --manufacturer Other "
        "--serial-number 7 --driving-state-interval 0.5 --no-maps-in-state "
        f"--state-folder {tmp_path}"
    )
    assert main(options.split()) == 0
    (vehicle,) = made
    assert vehicle.link.ip == "robot"
    assert vehicle == VehicleConfig(
        vehicle.link,
        manufacturer="Other",
        serial_number="7",
        interface="a/b",
        version=V3_0,
        limits=Limits(driving_state_interval=0.5, maps_in_state=False),
        state_folder=tmp_path,
    )


def test_without_its_libraries_the_program_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("program", "mqtt"):
        monkeypatch.delitem(sys.modules, f"woosh_robot_agent.vda5050.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "aiomqtt", None)
    assert main(["--help"]) == 1
    assert "pip install 'aiomqtt>=2.3' 'jsonschema>=4.20'" in capsys.readouterr().err
