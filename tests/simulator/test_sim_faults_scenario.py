"""Scheduled faults, from scenario files and from the command line."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from tests.simulator.sim_wire import Connect, JsonClient
from tests.simulator.test_sim_program import running
from woosh_robot_agent.simulator import FaultError, Scenario, SimulatorThread, load_scenario
from woosh_robot_agent.simulator.__main__ import main
from woosh_robot_agent.simulator.faults import markdown, parse_fault
from woosh_robot_agent.testing import wait_until

SCENARIO = """\
# entries need not be in order of time
- {at: 30, do: lost_localisation, for: 10}
- at: 10
  do: emergency_stop
  for: 5.5
- {at: 60, do: refuse, type: woosh.robot.Speak, text: "not now: busy"}
- {at: 60, do: drop}
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(SCENARIO)
    return path


INVALID_SCENARIOS = {
    "- {at: 1, do: drop": "not readable as YAML",
    "\0": "not readable as YAML",
    "[" * 5000: "nested more than 20 levels",
    "drop": "not a list of {at: SECONDS, do: NAME}",
    "": "not a list",
    "- drop": "entry 1: 'drop' is not of the form {at: SECONDS, do: NAME}",
    "- {at: 1, 5: drop}": "entry 1: ",
    "- {at: 1, do: drop}\n- {do: drop}": "entry 2: drop: `at` is missing",
    "- {at: 1}": "entry 1: `do` must name a fault",
    "- {at: -1, do: drop}": "entry 1: drop: at: -1 is not a number of at least 0, in s of",
    "- {at: 1, do: dorp}": "entry 1: unknown fault 'dorp': use one of emergency_stop, ",
    "- {at: 1, do: off, for: }": "entry 1: off: for: None is not a number",
}
INVALID_OPTIONS = {
    "": "unknown fault '': use one of ",
    "'": "No closing quotation",
    "delay 3": "delay: '3' is not of the form key=value",
    "delay seconds=1 seconds=2": "delay: seconds is given twice",
    "delay seconds=x": "delay: seconds: 'x' is not a number from 0 to 86400, in s of",
    "delay count=1.5": "delay: count: '1.5' is not an integer of at least 0",
}


def test_invalid_scenario_files_are_refused_with_a_hint(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    for text, complaint in INVALID_SCENARIOS.items():
        path.write_text(text)
        with pytest.raises(FaultError) as error:
            load_scenario(path)
        assert str(error.value).startswith(f"{path}: ")
        assert complaint in str(error.value)


def test_invalid_options_are_refused_with_a_hint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for text, complaint in INVALID_OPTIONS.items():
        with pytest.raises(SystemExit) as exit_:
            main(["--fault", text])
        assert exit_.value.code == 2
        assert complaint in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--scenario", str(tmp_path / "none.yaml")])
    assert "No such file" in capsys.readouterr().err


@pytest.mark.chassis(scenario=Scenario((parse_fault("off for=20"),)))
def test_faults_due_at_the_start_begin_before_the_first_client(
    simulator: SimulatorThread, connect: Connect
) -> None:
    assert simulator.injected["off"] == 1
    wait_until(lambda: not simulator.faults)
    simulator.clear_faults()  # returns once the simulator listens again
    connect().ask("woosh.robot.Mode")


def test_program_runs_scenario_and_fault_options(scenario: Path) -> None:
    arguments = ("--scenario", str(scenario), "--speed", "100", "-v", "--seed", "2")
    refuse = "refuse type=woosh.robot.SetOccupancy text='by hand'"
    freeze = "freeze at=20 for=5"
    with running(*arguments, "--fault", refuse, "--fault", freeze) as (process, port, _):
        assert process.stderr
        log = []
        for line in process.stderr:
            log += [line.strip().partition("faults.fault: ")[2]] if "faults.fault" in line else []
            if "fault: drop" in line:
                break
        with closing(JsonClient(port)) as client:
            assert client.refusal("woosh.robot.SetOccupancy") == "by hand"
            assert client.refusal("woosh.robot.Speak") == "not now: busy"
            codes = client.ask("woosh.robot.count.StatusCodes")["scs"]
    assert [code["code"] for code in codes] == ["110201000013", "130103000012"]
    stop, lost = (int(code["time"]) - 1735689600000 for code in codes)
    # The freeze stops the clock of the robot.
    assert (stop, lost) == (10_000, pytest.approx(30_000 - 5_000, abs=200))
    assert log == [
        "fault begins: refuse text='by hand' type=woosh.robot.SetOccupancy",
        "fault begins: emergency_stop for=5.5",
        "fault ends: emergency_stop for=5.5",
        "fault begins: freeze for=5.0",
        "fault ends: freeze for=5.0",
        "fault begins: lost_localisation for=10.0",
        "fault ends: lost_localisation for=10.0",
        "fault begins: refuse text='not now: busy' type=woosh.robot.Speak",
        "fault: drop",
    ]


def test_list_faults_prints_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list-faults"]) == 0
    assert capsys.readouterr().out == markdown() + "\n"
