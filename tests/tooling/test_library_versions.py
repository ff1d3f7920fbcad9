"""Libraries that are too old or missing are named, with the remedy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import google.protobuf
import pytest

from woosh_robot_agent import agent, program


@pytest.mark.parametrize(
    ("websockets", "protobuf", "named"),
    [
        ("9.1", "3.12.4", "websockets 9.1 and protobuf 3.12.4"),
        ("9.1", "6.30.0", "websockets 9.1"),
        ("10.4", "3.20.3", "protobuf 3.20.3"),
    ],
)
def test_the_agent_names_old_libraries_and_ends(monkeypatch, capsys, websockets, protobuf, named):
    monkeypatch.setattr("websockets.version.version", websockets)
    monkeypatch.setattr(google.protobuf, "__version__", protobuf)
    assert agent._run([], signals=None) == 2  # type: ignore[arg-type]
    assert capsys.readouterr().err == (
        f"agent: too old: {named}; run: python3 -m pip install 'websockets>=10.4' "
        "'protobuf>=3.21'\n"
    )


@pytest.mark.parametrize(("websockets", "protobuf"), [("10.4", "3.21.12"), ("17.4", "4.21.12")])
def test_supported_libraries_are_accepted(monkeypatch, websockets, protobuf):
    monkeypatch.setattr("websockets.version.version", websockets)
    monkeypatch.setattr(google.protobuf, "__version__", protobuf)
    assert program.outdated_libraries() == ""


def run_without(module: str, program: str, *arguments: str) -> tuple[int, str]:
    """Run a program where a module cannot be imported; return its exit status and stderr."""
    module_name, *names = program.split()
    code = f"""
import runpy, sys
sys.modules[{module!r}] = None
runpy.run_module("woosh_robot_agent.{module_name}", run_name="__main__")
"""
    done = subprocess.run(
        [sys.executable, "-c", code, *names, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert not done.stdout
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("module", "program", "arguments"),
    [
        ("rclpy", "agent", []),
        ("rclpy._rclpy_pybind11", "tools monitor", []),
        ("rcl_interfaces", "tools record", ["--ip", "127.0.0.1:1", "--ros"]),
    ],
)
def test_a_program_that_needs_ros_tells_how_to_get_it(
    module: str, program: str, arguments: list[str], tmp_path: Path
) -> None:
    pytest.importorskip("rclpy")
    if program == "tools record":
        arguments = [*arguments, "--output", str(tmp_path / "a.mcap")]
    status, said = run_without(module, program, *arguments)
    assert status in (1, 2)
    assert "ROS is not available" in said
    assert "source the setup files of ROS and of the workspace" in said
    assert ("or use --ip" in said) == (program == "tools monitor")
    assert "Traceback" not in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("program", "module", "remedy"),
    [
        ("agent", "websockets", "'websockets>=10.4'"),
        ("simulator", "google", "'protobuf>=3.21'"),
        (
            "tools record",
            "mcap_protobuf",
            "mcap mcap-protobuf-support foxglove-schemas-protobuf",
        ),
        ("vda5050", "google", "'protobuf>=3.21'"),
    ],
)
def test_a_missing_library_is_named(program: str, module: str, remedy: str) -> None:
    status, said = run_without(module, program)
    assert status in (1, 2)
    assert said.endswith(f"run: python3 -m pip install {remedy}\n"), said
    assert len(said.splitlines()) == 1


def test_the_libraries_of_recordings_fit_an_old_protobuf(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(google.protobuf, "__version__", "4.21.12")
    problem = program.import_problem(ModuleNotFoundError(name="mcap.writer"))
    assert "pip install mcap 'mcap-protobuf-support<0.4'" in problem


def test_a_python_of_the_system_needs_options_of_pip(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    missing = ModuleNotFoundError(name="orjson")
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(tmp_path))
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    assert program.import_problem(missing).endswith("pip install orjson")  # a virtual environment
    monkeypatch.setattr(sys, "prefix", "/usr")
    problem = program.import_problem(missing)
    assert problem.endswith("pip install --user --break-system-packages orjson")


def test_what_is_missing_of_this_package_is_told_unless_it_only_needs_compiling() -> None:
    problem = program.import_problem(ModuleNotFoundError(name="woosh_robot_agent.pb"))
    assert "not compiled; run scripts/setup or python3 setup.py build_proto" in problem
    status, said = run_without("woosh_robot_agent.link", "tools doctor")
    assert status == 1
    assert "Traceback" in said
