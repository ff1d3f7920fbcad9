"""Start and end of the agent's program."""

from __future__ import annotations

import logging
import os
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
from tests.node.goals import ABORTED, EXECUTING, lift3, slow_down, step, stop_time, task
from woosh_robot_agent import agent
from woosh_robot_agent.parameters import PARAMETERS
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing.agents import domain_variables
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


def test_rclpy_does_not_warn(domain: int) -> None:
    """The executor of rclpy prints its warnings to stdout."""
    program = subprocess.Popen(
        [sys.executable, "-m", "woosh_robot_agent.agent"]
        + ["--ros-args", "-p", "ip:=127.0.0.1", "-p", "port:=1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **domain_variables(domain)},
    )
    assert program.stderr is not None
    assert any("cannot connect" in line for line in program.stderr)
    program.send_signal(signal.SIGINT)
    stdout, _ = program.communicate(timeout=TIMEOUT)
    assert "Warning" not in stdout


def in_first_turn(domain: int, code: str) -> subprocess.CompletedProcess[str]:
    """Run the program until the first turn of its executor, and the code in that."""
    program = f"""
import ctypes, gc, os, signal
from woosh_robot_agent import agent

def turn(executor, timeout):
    {code}
    os.kill(os.getpid(), signal.SIGTERM)

agent._spin_once = turn
agent.main()
"""
    return subprocess.run(
        [sys.executable, "-c", program],
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, **domain_variables(domain)},
    )


def test_the_garbage_collector_ignores_objects_of_the_start(domain: int) -> None:
    run = in_first_turn(domain, "print(gc.isenabled(), gc.get_freeze_count() > 10_000)")
    assert "True True" in run.stdout.splitlines()  # Fast DDS may print to stdout as well


def test_all_threads_share_one_heap(domain: int) -> None:
    """glibc returns the unused memory of the first heap only."""
    run = in_first_turn(domain, "ctypes.CDLL(None).malloc_stats()")
    assert set(re.findall(r"^Arena \d+:", run.stderr, re.MULTILINE)) == {"Arena 0:"}


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


def test_program_ends_while_connecting(start_program: Callable[..., Program]) -> None:
    """The server accepts the connection and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        program = start_program(ip="127.0.0.1", port=silent.getsockname()[1])
        silent.settimeout(TIMEOUT)
        connection, _ = silent.accept()
        with connection:
            program.end()


@pytest.mark.parametrize("loaded", ["", "_rclpy_pybind11", "librmw_fastrtps_cpp"])
def test_program_ends_while_starting(start_program: Callable[..., Program], loaded: str) -> None:
    program = start_program(ip="127.0.0.1", port=1)
    process = Path(f"/proc/{program.process.pid}")

    def ready() -> bool:
        caught = re.search(r"SigCgt:\s*(\w+)", (process / "status").read_text())
        assert caught is not None
        taken = int(caught[1], 16) >> (signal.SIGTERM - 1) & 1
        return bool(taken) and loaded in (process / "maps").read_text()

    wait_until(ready)
    program.end(signal.SIGTERM)


def test_program_ends_cleanly_after_further_signals(
    program: Program, simulator: SimulatorThread, client: Client
) -> None:
    drive(client)
    simulator.inject("half_open")
    program.process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        program.process.wait(0.4)
    program.process.send_signal(signal.SIGINT)
    program.end(signal.SIGTERM)


def test_program_ends_cleanly_though_signals_arrive_until_it_has_ended(program: Program) -> None:
    """A signal must not end the interpreter while it shuts down."""
    process = program.process
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.001)  # only lets the process run
    program.wait_read()
    assert process.returncode == 0, program.output


def test_open_goal_is_aborted(program: Program, simulator: SimulatorThread, client: Client) -> None:
    slow_down(simulator)
    goals = [task(client, mark="A23"), step(client, 100.0)]
    goals[1].result()  # refused because a task is running, so not an open goal
    goals[0].feedback.wait(lambda fb: fb.state.value == EXECUTING)
    stop_time(simulator)
    program.end()
    goals[0].wait_aborted("stopping")
    assert simulator.call(lambda sim: sim.chassis.tasks.active), "the task is the robot's own"


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


@pytest.mark.parametrize("speeds", [[], [0.2], [0.2, 0.0]], ids=["untouched", "driven", "stopped"])
def test_robot_is_stopped_only_if_the_agent_drove_it(
    program: Program, simulator: SimulatorThread, client: Client, speeds: list[float]
) -> None:
    for speed in speeds:
        drive(client, speed)
    program.end(signal.SIGTERM)
    wait_until(lambda: simulator.connections == 0)
    twists = [each.message.linear for each in simulator.received if each.type == TWIST]
    assert twists == pytest.approx([0.2, 0.0] if speeds else [])


def test_program_ends_quietly_with_a_simulator_that_ends_by_the_same_ctrl_c(
    start_program: Callable[..., Program],
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    simulator = subprocess.Popen(
        [sys.executable, "-m", "woosh_robot_agent.simulator"]
        + ["--port", str(port), "--tcp-port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        assert simulator.stdout is not None
        assert b"ready" in simulator.stdout.readline()
        program = start_program(ip="127.0.0.1", port=port)
        program.wait_says("connected to")
        program.process.send_signal(signal.SIGINT)
        simulator.send_signal(signal.SIGINT)
        simulator.wait(TIMEOUT)
        assert program.process.wait(TIMEOUT) == 0
        program.wait_read()
    finally:
        simulator.kill()
        simulator.communicate()
    assert not re.search(r"WARN|ERROR", program.output), program.output


@pytest.mark.parametrize(
    ("argument", "complaint"),
    [
        ("port:=65536", "port"),
        ("port:=abc", "port"),
        ("transport:=udp", "transport"),
        ("goal_link_timeout:=.nan", "goal_link_timeout"),
    ],
)
def test_bad_parameter_ends_the_program_with_one_line(
    start_program: Callable[..., Program], argument: str, complaint: str
) -> None:
    said = start_program("-p", argument).wait_refused()
    assert len(said.strip().splitlines()) == 1, said
    assert re.search(rf"\b{complaint}\b", said), said
    assert "('" not in said, "a tuple instead of a text"


def test_malformed_arguments_end_the_program_with_one_line(
    start_program: Callable[..., Program],
) -> None:
    said = start_program("-p", "port").wait_refused().splitlines()
    assert [line for line in said if line.startswith("agent: ")] == said[-1:]
    assert len(said) <= 2, "rcl logs an error, too"


def test_unknown_arguments_are_named(start_program: Callable[..., Program]) -> None:
    said = start_program("--parms-file", "my.yaml").wait_refused()
    assert re.search(r"unknown arguments.*--parms-file", said), said


def drive(client: Client, linear: float = 0.2) -> Any:
    response = client.call(Twist, "robot/Twist", arg=TwistMsg(linear=linear))
    assert response.ok
    return response


def run_agent(*arguments: str, **options: Any) -> tuple[int, str, str]:
    """Run the agent until it ends; return its exit status, stdout and stderr."""
    done = subprocess.run(
        [sys.executable, "-m", "woosh_robot_agent.agent", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
        **options,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["--ip", "1", "--help"]])
def test_help_names_the_parameters_that_matter(arguments: list[str]) -> None:
    status, out, err = run_agent(*arguments)
    assert (status, err) == (0, "")
    assert "--ros-args -r __ns:=/woosh_robot -p ip:=" in out
    named = set(re.findall(r"-p (\w+):=", out))
    assert {"ip", "port"} <= named <= {each.name for each in PARAMETERS}
    assert next(each.initial for each in PARAMETERS if each.name == "ip") in out
    assert "agent.yaml" in out
    assert "docs/" in out


def test_help_and_version_need_no_ros() -> None:
    for argument in ("--help", "--version"):
        # -S: without the folder in which rclpy is installed
        bare = [sys.executable, "-S", "-m", "woosh_robot_agent.agent", argument]
        root = str(Path(agent.__file__).parents[1])
        done = subprocess.run(
            bare, capture_output=True, text=True, check=False, env={"PYTHONPATH": root}
        )
        assert (done.returncode, done.stderr) == (0, "")
        assert "agent" in done.stdout


def test_version_is_that_of_the_package() -> None:
    root = Path(agent.__file__).parents[1]
    declared = re.search(r"<version>(.*)</version>", (root / "package.xml").read_text())
    assert declared
    assert run_agent("--version") == (0, f"agent {declared[1]}\n", "")


@pytest.mark.parametrize(
    ("arguments", "right"),
    [
        ("--ip 127.0.0.1", "agent --ros-args -p ip:=127.0.0.1"),
        ("--ip=127.0.0.1", "agent --ros-args -p ip:=127.0.0.1"),
        ("ip:=127.0.0.1", "agent --ros-args -p ip:=127.0.0.1"),
        ("--observe-only --ip 1", "agent --ros-args -p observe_only:=true"),
        ("--port --ip 1", "agent --ros-args -p port:=VALUE"),
        ("-p ip:=127.0.0.1 -p port:=1", "agent --ros-args -p ip:=127.0.0.1 -p port:=1"),
        ("--params-file mine.yaml", "agent --ros-args --params-file mine.yaml"),
        ("--nonsense", "agent --ros-args -p ip:=172.20.8.74"),
        ("leftover", "agent --ros-args -p ip:=172.20.8.74"),
        ("--ros-args -p port:=1 -- --ip 127.0.0.1", "agent --ros-args -p ip:=127.0.0.1"),
    ],
)
def test_arguments_that_ros_ignores_are_refused_with_the_right_way(
    arguments: str, right: str
) -> None:
    """The agent would connect to a robot at the default address."""
    words = arguments.split()
    # at the end, so that an agent that starts nevertheless stays on this computer
    status, out, err = run_agent(*words, "--ros-args", "-p", "ip:=127.0.0.1", "-p", "port:=1")
    assert (status, out) == (2, "")
    first = words[0] if words[0] != "--ros-args" else "--ip"
    assert err == (
        f"agent: unknown argument: {first}; pass parameters as ROS arguments, e.g. {right}; see "
        "agent --help\n"
    )


@pytest.mark.parametrize(
    ("variable", "arguments"),
    [
        ("HOME=", []),
        ("HOME={file}", []),
        ("ROS_HOME={file}", []),
        ("ROS_LOG_DIR=/proc", []),
        ("ROS_LOG_DIR=/proc", ["--enable-external-lib-logs"]),
    ],
)
def test_agent_runs_where_logs_cannot_be_written(
    start_program: Callable[..., Program],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    variable: str,
    arguments: list[str],
) -> None:
    file = tmp_path / "file"
    file.touch()
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(*variable.format(file=file).split("="))
    program = start_program(*arguments, ip="127.0.0.1", port=1)
    program.wait_says("cannot connect")
    program.end()
    warning = program.lines[0]
    assert re.match("warning: no log file is written: cannot write to ", warning)
    assert "set ROS_LOG_DIR" in warning


def test_log_files_are_written_where_possible(
    start_program: Callable[..., Program], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "new" / "logs"))
    program = start_program(ip="127.0.0.1", port=1)
    program.wait_says("cannot connect")
    program.end()
    (file,) = (tmp_path / "new" / "logs").iterdir()
    assert "cannot connect" in file.read_text()
    assert "warning: " not in program.output


@pytest.mark.parametrize(
    ("limit", "parameter", "needed"),
    [(16, "port:=1", 64), (40, "port:=1", 64), (63, "port:=1", 64), (64, "robots:=[a, b, c]", 66)],
)
def test_too_few_file_descriptors_are_named(limit: int, parameter: str, needed: int) -> None:
    arguments = ["--ros-args", "-p", "ip:=127.0.0.1", "-p", parameter]
    status, out, err = run_agent(
        *arguments, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    )
    assert (status, out) == (2, "")
    assert err.startswith(f"agent: too few file descriptors: the limit is {limit}, and {needed} ")
    assert "ulimit -n" in err
    assert len(err.splitlines()) == 1


def test_a_folder_of_messages_that_cannot_be_read_is_not_omitted() -> None:
    """Otherwise each message in it would be unknown, and nothing would tell why."""
    code = """
import os, resource
from woosh_robot_agent.link.protos import message_types
free = os.dup(0)
os.close(free)
resource.setrlimit(resource.RLIMIT_NOFILE, (free, free))
try:
    message_types()
except OSError as error:
    print(error.strerror)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "Too many open files\n"
