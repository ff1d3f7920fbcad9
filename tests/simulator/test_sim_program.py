"""The simulator as a program."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from tests.simulator.sim_wire import TIMEOUT, JsonClient, TcpClient
from woosh_robot_agent.simulator.__main__ import main

PROGRAM = [sys.executable, "-m", "woosh_robot_agent.simulator"]
PATIENT_PROGRAM = [
    sys.executable,
    "-c",
    "import sys\n"
    "from woosh_robot_agent.simulator import __main__, command_line\n"
    "command_line._DISCONNECT_TIMEOUT = None\n"
    "sys.exit(__main__.main())",
]
"""The program without a limit on the time for which it serves clients after a signal."""
FAULT = 6
READY = re.compile(r"simulated chassis ready on ws://[\d.]+:(\d+) and tcp://[\d.]+:(\d+)\n")


@contextmanager
def running(
    *arguments: str, program: Sequence[str] = PROGRAM, on_hangup: Any = signal.SIG_DFL
) -> Iterator[tuple[subprocess.Popen[str], int, int]]:
    """Run the simulator as a program. Yield its process, WebSocket port and TCP port."""
    process = subprocess.Popen(
        [*program, "--port", "0", "--tcp-port", "0", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, on_hangup),
    )
    assert process.stdout
    try:
        ready = READY.fullmatch(process.stdout.readline())
        assert ready
        yield process, int(ready[1]), int(ready[2])
    finally:
        process.kill()
        process.communicate()


def test_options_of_the_program_and_its_end_by_a_signal(tmp_path: Path) -> None:
    walls = "[[-9, -9, 9, -9, 9, 9, -9, 9, -9, -9]]"
    (tmp_path / "scene.yaml").write_text(f"name: hall\nmaps: [{{name: ground, walls: {walls}}}]\n")
    options = ("--robot-id", "7", "--base", "differential", "--uninitialised")
    options = (*options, "--clock-offset", "-32400", "--scene", str(tmp_path))
    options = (*options, "--code-language", "none", "--fault", "emergency_stop")
    options = (*options, "--max-frame", "1000", "--max-connections", "2", "--host", "0.0.0.0")
    with (
        running(*options) as (process, port, tcp_port),
        closing(JsonClient(port)) as client,
        closing(TcpClient(tcp_port)) as tcp,
    ):
        assert client.ask("woosh.robot.General")["driverMethod"] == 0
        assert client.ask("woosh.robot.Mode")["robotId"] == 7
        assert client.ask("woosh.robot.RobotState")["state"] == FAULT
        assert client.ask("woosh.robot.DeviceState")["software"] & 1 == 0  # not localised
        assert tcp.request("woosh.robot.Mode").ok
        robot = client.request("woosh.robot.Mode")["timestamp"] / 1000
        assert time.time() - robot == pytest.approx(9 * 3600, abs=60)
        scene = client.ask("woosh.robot.Scene")
        assert (scene["sceneName"], scene["mapName"]) == ("hall", "ground")
        names = [each["name"] for each in client.ask("woosh.map.SceneList")["scenes"]]
        assert names == ["wooshmap", "scenex", "hall"]
        (code,) = client.ask("woosh.robot.count.AbnormalCodes")["scs"]
        assert (code["code"], code["msg"]) == ("110201000013", "")
        with closing(TcpClient(tcp_port)) as third, pytest.raises(ConnectionError):
            third.request("woosh.robot.Mode")
        client.send({"type": "woosh.robot.Mode", "body": {}, "sn": 1, "padding": "x" * 1000})
        with pytest.raises(ConnectionClosed):
            client.receive()
        process.send_signal(signal.SIGTERM)
        # The client over TCP does not disconnect.
        out, err = process.communicate(timeout=TIMEOUT)
        assert (process.returncode, out) == (0, "")
        assert err.startswith("warning: everybody who can reach 0.0.0.0")


def test_client_is_served_after_a_signal() -> None:
    """The client may be an agent that the same Ctrl-C ends: it stops the robot first."""
    with running(program=PATIENT_PROGRAM) as (process, port, _):
        client = JsonClient(port)
        client.ask("woosh.robot.Twist", {"linear": 0.2})
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)  # a repeat, as some launchers send it
        client.subscribe("woosh.robot.PoseSpeed")
        client.next_push("woosh.robot.PoseSpeed")
        client.ask("woosh.robot.Twist")
        client.close()
        assert process.communicate(timeout=TIMEOUT) == ("", "")
        assert process.returncode == 0


@pytest.mark.parametrize("on_hangup", [signal.SIG_DFL, signal.SIG_IGN], ids=["plain", "nohup"])
def test_a_closed_terminal_ends_the_program_unless_nohup_has_started_it(on_hangup: Any) -> None:
    with running(on_hangup=on_hangup) as (process, port, _):
        process.send_signal(signal.SIGHUP)
        if on_hangup is signal.SIG_IGN:
            with closing(JsonClient(port)) as client:
                client.ask("woosh.robot.Mode")
            process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=TIMEOUT) == ("", "")
        assert process.returncode == 0


def test_further_signals_end_the_program_though_a_client_is_connected() -> None:
    with (
        running(program=PATIENT_PROGRAM) as (process, port, _),
        closing(JsonClient(port)),
    ):
        deadline = time.monotonic() + TIMEOUT
        while process.poll() is None:
            assert time.monotonic() < deadline, "further signals have no effect"
            process.send_signal(signal.SIGINT)
            time.sleep(0.001)  # only lets the process run
        assert process.communicate() == ("", "")
        assert process.returncode == 0


SIGNAL_ON_IMPORT = """
import os, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGTERM)

from woosh_robot_agent.simulator.__main__ import main
sys.meta_path.insert(0, Finder())
sys.exit(main(["--port", "0", "--tcp-port", "0"]))
"""


@pytest.mark.parametrize(
    "module",
    ["asyncio", "woosh_robot_agent.simulator.server"],
)
def test_signal_during_startup_ends_it_cleanly(module: str) -> None:
    command = [sys.executable, "-c", SIGNAL_ON_IMPORT, module]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


def test_port_in_use_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["--port", str(port), "--tcp-port", "0"]) == 1
        out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: cannot listen on 127.0.0.1")
    assert str(port) in err
    assert err.count("\n") == 1


def test_out_of_range_options_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for option, value, reason in (
        ("--speed", "0", "is not within"),
        ("--speed", "1000", "is not within"),
        ("--port", "70000", "is not within"),
        ("--robot-id", "0", "is not within"),
        ("--max-frame", "0", "max_frame 0 is not at least 1"),
        ("--max-connections", "0", "max_connections 0 is not at least 1"),
        ("--max-waiting", "0", "max_waiting 0 is not at least 1"),
        ("--max-outbox", "0", "max_outbox 0 is not at least 1"),
        ("--code-language", "fr", "invalid choice: 'fr'"),
    ):
        with pytest.raises(SystemExit) as exit_:
            main([option, value])
        assert exit_.value.code == 2
        assert reason in capsys.readouterr().err
