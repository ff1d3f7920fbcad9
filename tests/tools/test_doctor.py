"""The doctor: against a real socket, each of its lines failing once."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_agent.tools.checks import CHECKS
from woosh_robot_agent.tools.doctor import main

SHORT = "0.5"
"""s that what never answers is waited for."""
INFO = "woosh.robot.RobotInfo"


class Report:
    """What the doctor says of one robot."""

    def __init__(self, status: int, text: str) -> None:
        self.status = status
        self._json = json.loads(text)
        self.checks = {check["check"]: check for check in self._json["checks"]}
        assert tuple(self.checks) == CHECKS
        assert self._json["ok"] is (status == 0)

    def found(self, *statuses: str) -> list[str]:
        return [name for name, check in self.checks.items() if check["status"] in statuses]

    def text(self, name: str) -> str:
        return f"{self.checks[name]['text']} -> {self.checks[name]['remedy']}"


@pytest.fixture
def examine(capsys: pytest.CaptureFixture[str]) -> Callable[..., Report]:
    def run(port: int, *arguments: str, ip: str = "127.0.0.1", skew: str = "60") -> Report:
        # a loaded machine lets simulated time lag behind
        status = main(["--ip", ip, "--port", str(port), "--max-skew", skew, "--json", *arguments])
        out, err = capsys.readouterr()
        assert err == ""
        return Report(status, out)

    return run


@contextlib.contextmanager
def peer(answer: bytes | None) -> Iterator[int]:
    """Something else on a port: it says `answer` and hangs up, or says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken: list[socket.socket] = []

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    taken.append(connection)
                    if answer is not None:
                        with contextlib.suppress(OSError):
                            connection.recv(1)
                            connection.sendall(answer)
                            connection.shutdown(socket.SHUT_WR)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        thread.join(5)
        for connection in taken:
            connection.close()


def test_a_ready_robot(chassis, examine):
    report = examine(chassis.port)
    assert report.status == 0
    assert report.found("ok") == list(CHECKS)
    assert "Robase200" in report.text("RobotInfo")


@pytest.mark.parametrize(
    ("arguments", "port"),
    [(("--transport", "tcp"), "tcp_port"), (("--encoding", "protobuf"), "port")],
)
def test_protobuf_has_no_clock(chassis, examine, arguments, port):
    report = examine(getattr(chassis, port), *arguments)
    assert (report.status, report.found("warn")) == (0, ["clock"])
    assert report.found("ok") == list(CHECKS[:-1])


def test_a_name_with_several_addresses(chassis, examine, monkeypatch):
    """As localhost often has ::1 first, and the chassis the other one."""
    port = chassis.port
    addresses = [
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", (host, port))
        for host in ("127.0.0.2", "127.0.0.1")
    ]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: addresses)
    report = examine(port, ip="robot.example")
    assert report.status == 0
    assert report.text("network").startswith("127.0.0.1 answers")


def test_it_never_commands(chassis, examine):
    examine(chassis.port)
    assert dict(chassis.counts) == {INFO: 1}


def test_no_such_host(examine):
    report = examine(5480, "--timeout", "5", ip="no-such-host.invalid")
    assert (report.status, report.found("fail")) == (1, ["network"])
    assert report.found("skip") == list(CHECKS[1:])
    assert "no-such-host.invalid" in report.text("network")


def test_nobody_answers(examine):
    """A full queue of connections drops further ones, as a robot that is off does."""
    with socket.socket() as server, contextlib.ExitStack() as stack:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        for _ in range(4):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                filler.connect(server.getsockname())
        report = examine(server.getsockname()[1], "--timeout", SHORT)
    assert (report.status, report.found("fail")) == (1, ["network"])
    assert "does not answer within 0.5 s" in report.text("network")
    assert "firewall" in report.text("network")


def test_nothing_listens(examine):
    with socket.socket() as unused:  # bound, so that nobody else takes the port
        unused.bind(("127.0.0.1", 0))
        report = examine(unused.getsockname()[1])
    assert (report.status, report.found("fail")) == (1, ["port"])
    assert report.found("ok") == ["network"]
    assert "Connection refused" in report.text("port")


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (None, "says nothing within 0.5 s"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "no chassis: not a WebSocket server"),
        (b"220 ready\r\n", "no chassis"),
        (b"", "no chassis"),
    ],
)
def test_another_program_on_the_port(examine, answer, text):
    with peer(answer) as port:
        report = examine(port, "--timeout", SHORT if answer is None else "5")
    assert (report.status, report.found("fail")) == (1, ["handshake"])
    assert report.found("ok") == ["network", "port"]
    assert text in report.text("handshake")


def test_robot_info_is_not_answered(chassis, examine):
    chassis.mute(INFO)
    report = examine(chassis.port, "--timeout", SHORT)
    assert (report.status, report.found("fail")) == (1, ["RobotInfo"])
    assert "no answer within 0.5 s" in report.text("RobotInfo")


def test_robot_info_is_refused(chassis, examine):
    chassis.refuse(INFO, "ask somebody else")
    report = examine(chassis.port)
    assert (report.status, report.found("fail")) == (1, ["RobotInfo"])
    assert "ask somebody else" in report.text("RobotInfo")


def test_something_else_is_answered(chassis, examine):
    chassis.answer_as(INFO, "woosh.robot.Mode")
    report = examine(chassis.port)
    assert report.found("fail") == ["RobotInfo"]
    assert "woosh.robot.Mode" in report.text("RobotInfo")


def test_an_answer_that_cannot_be_read(chassis, examine):
    def spoil(frame: Any) -> list[Any]:
        chassis_side.append(frame)
        return []

    chassis_side: list[Any] = []
    chassis.intercept(spoil)

    def send_garbage() -> None:
        chassis.wait_received(INFO)
        sn = chassis_side[-1].sn
        chassis.send_raw("rubbish")
        chassis.send_raw(json.dumps({"type": INFO, "sn": sn, "ok": True, "body": {"mode": 3}}))

    sender = threading.Thread(target=send_garbage)
    sender.start()
    report = examine(chassis.port)
    sender.join(20)
    assert report.found("fail") == ["RobotInfo"]
    assert "cannot be read" in report.text("RobotInfo")


STATES = [
    ({"ctrl": robot.kManual}, ["mode", "taskable"], "mode", "key switch"),
    ({"ctrl": robot.kMaintain}, ["mode", "taskable"], "mode", "maintenance"),
    ({"work": robot.kDeployMode}, ["mode", "taskable"], "mode", "SwitchWorkMode"),
    ({"initialised": False}, ["initialisation", "taskable"], "initialisation", "InitRobot"),
    ({"located": False}, ["localisation", "taskable"], "localisation", "SetRobotPose"),
    ({"emergency_stop": True}, ["emergency stop", "taskable"], "emergency stop", "release"),
]


@pytest.mark.parametrize(("state", "failing", "where", "text"), STATES)
def test_a_robot_that_would_refuse(examine, chassis, set_state, state, failing, where, text):
    set_state(**state)
    report = examine(chassis.port)
    assert (report.status, report.found("fail")) == (1, failing)
    assert text in report.text(where)


def test_what_a_fault_hides_is_not_said_to_be_right(examine, chassis, set_state):
    set_state(emergency_stop=True, initialised=False)
    assert "initialisation" in examine(chassis.port).found("skip")


def test_all_that_is_wrong_at_once(examine, chassis, set_state):
    set_state(ctrl=robot.kManual, work=robot.kDeployMode, initialised=False, located=False)
    report = examine(chassis.port)
    assert "mode" in report.found("fail")
    for text in ("manual", "deployment"):
        assert text in report.text("mode")


def test_a_robot_that_says_nothing_of_itself(chassis, examine):
    def empty(frame: Any) -> list[Any]:
        frame.body.Clear()
        return [frame]

    chassis.intercept(empty)
    report = examine(chassis.port)
    assert report.status == 0
    assert report.found("warn") == list(CHECKS[4:9])


def test_clocks_differ(examine):
    with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, seed=1)) as other_day:
        report = examine(other_day.port, skew="1")
    assert (report.status, report.found("warn")) == (0, ["clock"])
    assert "behind" in report.text("clock")
    assert "days" in report.text("clock")
    assert "NTP" in report.text("clock")


def test_lines_for_people(chassis, set_state, capsys):
    set_state(ctrl=robot.kManual)
    assert main(["--ip", "127.0.0.1", "--port", str(chassis.port)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"robot at ws://127.0.0.1:{chassis.port}"
    mode = next(index for index, line in enumerate(lines) if line.startswith("FAIL  mode"))
    assert lines[mode + 1].strip().startswith("-> turn the key switch")


def test_lines_that_were_not_reached(capsys):
    with peer(b"") as port:
        assert main(["--ip", "127.0.0.1", "--port", str(port)]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("skip  RobotInfo, mode,")


@pytest.mark.parametrize(
    "arguments",
    [[], ["--ip", "a b"], ["--ip", "x", "--port", "70000"], ["--ip", "x", "--max-skew", "nan"]],
)
def test_wrong_usage(arguments, capsys):
    with pytest.raises(SystemExit) as ending:
        main(arguments)
    assert ending.value.code == 2
    assert "doctor: error:" in capsys.readouterr().err
