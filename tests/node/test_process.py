"""Start and end of the agent's program."""

from __future__ import annotations

import logging
import re
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.harness import TIMEOUT, Client, Program, wait_until
from tests.node.goals import ABORTED, lift3, task
from woosh_robot_agent import agent
from woosh_robot_agent.parameters import PARAMETERS
from woosh_robot_agent.ros.logs import init_arguments
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import Twist

TWIST = "woosh.robot.Twist"
LONG = {
    "poll_timeout": 600_000,
    "connect_timeout": 60.0,
    "liveness_timeout": 600.0,
    "goal_link_timeout": 600.0,
}
"""Long timeouts: a program that waits for one of them when it ends fails the test."""


@pytest.fixture
def start_program(start_program: Callable[..., Program]) -> Callable[..., Program]:
    """As in conftest.py, with the parameters in `LONG`."""
    return partial(start_program, **LONG)


def test_error_in_a_callback_is_logged_and_does_not_end_the_program(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging.getLogger("woosh_robot_agent"), "propagate", True)

    class Failing:
        def spin_once(self, timeout_sec: float) -> None:
            raise RuntimeError("mistake")

    agent._spin_once(Failing(), 0.0)
    assert "mistake" in caplog.text


def test_program_ends_while_driving_a_frozen_chassis_with_an_open_goal(
    program: Program, simulator: SimulatorThread, client: Client
) -> None:
    """In this slowest case every step of the shutdown runs into its timeout."""
    goal = lift3(client, 0.4, speed=0.001)
    goal.feedback.wait_count(1)
    drive(client)
    simulator.inject("half_open")
    program.end()
    assert goal.result()[0] == ABORTED


def test_program_ends_while_connecting_also_where_logs_cannot_be_written(
    start_program: Callable[..., Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server accepts the connection and never answers."""
    monkeypatch.setenv("ROS_LOG_DIR", "/proc")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = {"ip": "127.0.0.1", "port": silent.getsockname()[1]}
        program = start_program("--enable-external-lib-logs", **address)
        silent.settimeout(TIMEOUT)
        connection, _ = silent.accept()
        with connection:
            program.end()
    assert program.lines[0].startswith("warning: no log file is written")


def test_program_ends_while_starting(start_program: Callable[..., Program]) -> None:
    program = start_program(ip="127.0.0.1", port=1)
    process = Path(f"/proc/{program.process.pid}")

    def ready() -> bool:
        caught = re.search(r"SigCgt:\s*(\w+)", (process / "status").read_text())
        assert caught is not None
        taken = int(caught[1], 16) >> (signal.SIGTERM - 1) & 1
        return bool(taken) and "librmw_fastrtps_cpp" in (process / "maps").read_text()

    wait_until(ready)
    program.end(signal.SIGTERM)


def test_program_ends_cleanly_though_signals_arrive_until_it_has_ended(
    start_program: Callable[..., Program],
    simulator: SimulatorThread,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """A signal must not end the interpreter while it shuts down. The log file is complete then."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "new" / "logs"))
    program = start_program(ip="127.0.0.1", port=simulator.port)
    program.wait_says("connected to")
    process = program.process
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.001)  # only lets the process run
    program.wait_read()
    assert process.returncode == 0, program.output
    assert "warning: " not in program.output
    (file,) = (tmp_path / "new" / "logs").iterdir()
    assert "connected to" in file.read_text()


def test_robot_is_stopped_though_a_client_goes_on_driving(
    program: Program, simulator: SimulatorThread, client: Client
) -> None:
    stop = threading.Event()

    def repeat() -> None:
        while not stop.wait(0.02):
            client.call_async(Twist, "robot/Twist", arg=TwistMsg(linear=0.2))

    driving = threading.Thread(target=repeat)
    drive(client)
    task(client, mark="nowhere")
    driving.start()
    try:
        simulator.wait_received(TWIST, 10)
        program.end()
    finally:
        stop.set()
        driving.join()
    assert not simulator.last(TWIST).ListFields()


BAD_ARGUMENTS = {
    "-p port:=65536": r"\bport\b",
    "-p port": "-p port",  # rcl logs an error, too
    "--parms-file my.yaml": "unknown arguments.*--parms-file",
    "-p ip:=127.0.0.1 -p robots:=[a,b,c]": (
        "too few file descriptors: the limit is 64, and 66 are needed; raise it with ulimit -n"
    ),
}
"""ROS arguments with which the program does not start, and what it says."""
ALL_BAD_ARGUMENTS = """
import sys
from woosh_robot_agent.agent import main
for arguments in sys.argv[1:]:
    print("status", main(["--ros-args", *arguments.split()]), file=sys.stderr)
"""


@pytest.mark.usefixtures("domain")
def test_bad_arguments_end_the_program_with_one_line() -> None:
    """test_parameters.py has the values that are bad. One process tries all arguments."""
    done = subprocess.run(
        [sys.executable, "-c", ALL_BAD_ARGUMENTS, *BAD_ARGUMENTS],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64)),
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    *outputs, rest = done.stderr.split("status 2\n")
    assert rest == ""
    for told, said in zip(BAD_ARGUMENTS.values(), map(str.splitlines, outputs), strict=True):
        assert [line for line in said if line.startswith("agent: ")] == said[-1:]
        assert len(said) <= 2
        assert re.search(told, said[-1]), said
        assert "('" not in said[-1], "a tuple instead of a text"


WITHOUT_NETWORK = """
from woosh_robot_agent.agent import main
from woosh_robot_agent.ros import fleet
from woosh_robot_agent.ros.rclpy_private import RCLError
def fail(**_):
    raise RCLError("no network")
fleet.Fleet = fail
raise SystemExit(main([]))
"""


@pytest.mark.usefixtures("domain")
def test_after_an_error_of_the_middleware_systemd_restarts_the_program() -> None:
    """With status 2 it would not."""
    program = [sys.executable, "-c", WITHOUT_NETWORK]
    done = subprocess.run(program, capture_output=True, text=True, timeout=TIMEOUT)
    assert (done.returncode, done.stderr) == (1, "agent: no network\n")


def drive(client: Client, linear: float = 0.2) -> Any:
    response = client.call(Twist, "robot/Twist", arg=TwistMsg(linear=linear))
    assert response.ok
    return response


def test_help_and_version_need_no_ros() -> None:
    root = Path(agent.__file__).parents[1]

    def said(*arguments: str) -> str:
        # -S: without the folder in which rclpy is installed
        bare = [sys.executable, "-S", "-m", "woosh_robot_agent.agent", *arguments]
        done = subprocess.run(
            bare, capture_output=True, text=True, check=False, env={"PYTHONPATH": str(root)}
        )
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    declared = re.search(r"<version>(.*)</version>", (root / "package.xml").read_text())
    assert declared
    assert said("--version").startswith("agent ")
    assert agent._version() == declared[1]
    out = said("--ip", "1", "--help")
    assert "--ros-args -r __ns:=/woosh_robot -p ip:=" in out
    named = set(re.findall(r"-p (\w+):=", out))
    assert {"ip", "port"} <= named <= {each.name for each in PARAMETERS}, "those that matter"
    assert next(each.initial for each in PARAMETERS if each.name == "ip") in out
    assert "agent.yaml" in out
    assert "docs/" in out


@pytest.mark.parametrize(
    ("arguments", "right"),
    [
        ("--ip 127.0.0.1", "agent --ros-args -p ip:=127.0.0.1"),
        ("ip:=127.0.0.1", "agent --ros-args -p ip:=127.0.0.1"),
        ("--observe-only --ip 1", "agent --ros-args -p observe_only:=true"),
        ("--params-file mine.yaml", "agent --ros-args --params-file mine.yaml"),
        ("--nonsense", "agent --ros-args -p ip:=172.20.8.74"),
        ("--ros-args -p port:=1 -- --ip 127.0.0.1", "agent --ros-args -p ip:=127.0.0.1"),
    ],
)
def test_arguments_that_ros_ignores_are_refused_with_the_right_way(
    arguments: str, right: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The agent would connect to a robot at the default address."""
    words = arguments.split()
    # at the end, so that an agent that starts nevertheless stays on this computer
    here = ["--ros-args", "-p", "ip:=127.0.0.1", "-p", "port:=1"]
    assert agent._run([*words, *here], signals=None) == 2  # type: ignore[arg-type]
    first = words[0] if words[0] != "--ros-args" else "--ip"
    assert capsys.readouterr() == (
        "",
        f"agent: unknown argument: {first}; pass parameters as ROS arguments, e.g. {right}; see "
        "agent --help\n",
    )


@pytest.mark.parametrize("variable", ["HOME=", "ROS_HOME={file}"])
def test_where_logs_cannot_be_written_there_are_none(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    variable: str,
) -> None:
    file = tmp_path / "file"
    file.touch()
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(*variable.format(file=file).split("="))
    assert init_arguments(["one"]) == ["one", "--ros-args", "--disable-external-lib-logs"]
    warning = capsys.readouterr().err
    assert re.match("warning: no log file is written: cannot write to ", warning)
    assert "set ROS_LOG_DIR" in warning
