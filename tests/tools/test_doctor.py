"""`doctor` over real sockets: each check is seen to pass and to fail."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import re
import socket
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import pytest

from tests.quick_chassis import edit_bodies, quick_config
from tests.tools.connections import Connection, serving
from woosh_robot_agent.pb.robot.robot_pb2 import OperationState, RobotInfo, TaskProc
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.doctor import program as doctor
from woosh_robot_agent.tools.doctor.checks import Result, Status
from woosh_robot_agent.tools.doctor.program import CHECKS, main
from woosh_robot_agent.tools.options import add_link_options, link_config

SHORT = "0.5"
"""Timeout for a peer that never answers, in seconds."""
INFO = "woosh.robot.RobotInfo"


class Report:
    """Results of all checks, by name."""

    def __init__(self, results: list[Result]) -> None:
        self.checks = {result.check: result for result in results}
        assert tuple(self.checks) == CHECKS

    @property
    def failed(self) -> list[str]:
        return self.with_status(Status.FAIL)

    def with_status(self, status: Status) -> list[str]:
        return [name for name, result in self.checks.items() if result.status is status]

    def text(self, name: str) -> str:
        return f"{self.checks[name].text} -> {self.checks[name].remedy}"


def examine(port: int, *arguments: str, ip: str = "127.0.0.1", skew: float = 60.0) -> Report:
    """Check a robot. On a busy machine, simulated time lags behind real time."""
    parser = argparse.ArgumentParser()
    add_link_options(parser)
    config = link_config(parser, parser.parse_args(["--ip", f"{ip}:{port}", *arguments]))

    async def collect() -> Report:
        return Report([result async for result in doctor.examine(config, skew)])

    return asyncio.run(collect())


def peer(answer: bytes | None) -> AbstractContextManager[int]:
    """Run another program on a port: it sends `answer` and disconnects, or sends nothing."""

    def handle(connection: Connection) -> None:
        with contextlib.suppress(OSError):  # the doctor has disconnected
            if answer is not None:
                connection.rfile.read(1)
                connection.wfile.write(answer)
                connection.request.shutdown(socket.SHUT_WR)
            connection.rfile.read()

    return serving(handle)


@pytest.mark.parametrize(
    ("arguments", "port", "unchecked"),
    [
        ((), "port", []),
        (("--transport", "tcp"), "tcp_port", ["clock"]),
        (("--encoding", "protobuf"), "port", ["clock"]),
    ],
)
def test_a_ready_robot_passes_all_checks_of_one_request(chassis, arguments, port, unchecked):
    report = examine(getattr(chassis, port), *arguments)
    assert (report.failed, report.with_status(Status.WARN)) == ([], unchecked)
    assert report.with_status(Status.OK) == [name for name in CHECKS if name not in unchecked]
    assert "Robase200" in report.text("RobotInfo")
    assert dict(chassis.counts) == {INFO: 1}


def test_all_addresses_of_a_name_are_tried(chassis, monkeypatch):
    """The robot may not listen on the first address: `localhost` often resolves to ::1 first."""
    port = chassis.port
    addresses = [
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", (host, port))
        for host in ("127.0.0.2", "127.0.0.1")
    ]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: addresses)
    report = examine(port, ip="robot.example")
    assert report.failed == []
    assert report.text("network").startswith("127.0.0.1 is reachable")


def test_interface_of_a_link_local_address_is_kept():
    report = examine(5480, ip="[fe80::1%lo]")
    assert report.failed == ["network"]
    assert report.text("network").startswith("fe80::1%lo cannot be reached: ")
    assert "Invalid argument" not in report.text("network")


def test_unknown_host_fails():
    report = examine(5480, "--timeout", "5", ip="no-such-host.invalid")
    assert report.failed == ["network"]
    assert report.with_status(Status.SKIPPED) == list(CHECKS[1:])
    assert "no-such-host.invalid" in report.text("network")


def test_unreachable_address_fails():
    """A full backlog ignores further connections, as a robot that is switched off does."""
    with socket.socket() as server, contextlib.ExitStack() as stack:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        for _ in range(4):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                filler.connect(server.getsockname())
        report = examine(server.getsockname()[1], "--timeout", SHORT)
    assert report.failed == ["network"]
    assert "did not answer within 0.5 s" in report.text("network")
    assert "firewall" in report.text("network")


def test_closed_port_fails():
    with socket.socket() as unused:  # bound, so that no other program uses the port
        unused.bind(("127.0.0.1", 0))
        report = examine(unused.getsockname()[1])
    assert report.failed == ["port"]
    assert report.with_status(Status.OK) == ["network"]
    assert "Connection refused" in report.text("port")


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (None, "no answer came within 0.5 s"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "not a chassis: not a WebSocket server"),
        (
            b"HTTP/1.1 502 Bad Gateway\r\nServer: nginx/1.2\r\nContent-Length: 3\r\n\r\nBad",
            "; HTTP is answered with status 502 by nginx/1.2 -> check --ip",
        ),
        (b"220 ready\r\n", "not a chassis"),
        (b"", "not a chassis"),
    ],
)
def test_another_program_on_the_port_fails(answer, text):
    with peer(answer) as port:
        report = examine(port, "--timeout", SHORT if answer is None else "5")
    assert report.failed == ["handshake"]
    assert report.with_status(Status.OK) == ["network", "port"]
    assert text in report.text("handshake")


def proxy(port: int, refusal: bytes | None) -> AbstractContextManager[int]:
    """Run a proxy for HTTP: it answers handshakes of WebSockets with `refusal`, or not at all."""

    def handle(connection: Connection) -> None:
        head = b""
        while (line := connection.rfile.readline()).strip():
            head += line
        if b"upgrade: websocket" in head.lower():
            if refusal is None:
                connection.rfile.read()
            else:
                connection.wfile.write(refusal)
        elif length := re.search(rb"content-length: (\d+)", head.lower()):
            body = connection.rfile.read(int(length[1]))
            with socket.create_connection(("127.0.0.1", port)) as robot:
                robot.sendall(head + b"Connection: close\r\n\r\n" + body)
                while data := robot.recv(65536):
                    connection.wfile.write(data)

    return serving(handle)


@pytest.mark.parametrize(
    ("refusal", "reason"),
    [
        (b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\n\r\n", "HTTP 403"),
        (None, "no answer came within 2 s"),
    ],
)
def test_proxy_that_refuses_websockets_is_told_from_another_program(chassis, refusal, reason):
    with proxy(chassis.port, refusal) as port:
        report = examine(port, "--timeout", "2")
    assert report.failed == ["handshake"]
    text = report.text("handshake")
    assert text.startswith("robot 30001 answers HTTP requests at this address, but its WebSocket")
    assert "is not a chassis" not in text
    assert reason in text
    assert "-> a proxy or firewall between this computer and the robot" in text
    assert dict(chassis.counts) == {INFO: 1}


def damage(frame: Any) -> list[Any]:
    """Replace an answer by two that cannot be read."""
    body = {"type": INFO, "sn": frame.sn, "ok": True, "body": {"mode": 3}}
    return [
        replace(frame, damage=lambda *_, text=text: text) for text in ("rubbish", json.dumps(body))
    ]


@pytest.mark.parametrize(
    ("fault", "timeout", "text"),
    [
        (lambda chassis: chassis.mute(INFO), SHORT, "no answer within 0.5 s"),
        (lambda chassis: chassis.refuse(INFO, "ask somebody else"), "5", "ask somebody else"),
        (lambda chassis: chassis.answer_as(INFO, "woosh.robot.Mode"), "5", "woosh.robot.Mode"),
        (
            lambda chassis: chassis.inject("wrong_sn"),
            SHORT,
            "only an answer with the serial number 1000001 instead of 1 -> check --ip",
        ),
        (lambda chassis: chassis.inject("garbage"), SHORT, "the firmware is not supported"),
        (lambda chassis: chassis.intercept(damage), "5", "cannot be read"),
    ],
    ids=["no answer", "refusal", "another type", "another number", "garbage", "unreadable"],
)
def test_robot_info_without_a_usable_answer_fails(chassis, fault, timeout, text):
    fault(chassis)
    report = examine(chassis.port, "--timeout", timeout)
    assert report.failed == ["RobotInfo"]
    assert text in report.text("RobotInfo")


@pytest.mark.parametrize(
    ("state", "check", "text"),
    [
        ({"requested_control": robot.kManual}, "mode", "key switch"),
        ({"requested_control": robot.kMaintain}, "mode", "maintenance"),
        ({"work": robot.kDeployMode}, "mode", "SwitchWorkMode"),
        ({"initialised": False}, "initialisation", "InitRobot"),
        ({"located": False}, "localisation", "SetRobotPose"),
        ({"emergency_stop": True}, "emergency stop", "release"),
    ],
)
def test_each_reason_to_reject_a_task_is_named(chassis, set_state, state, check, text):
    set_state(**state)
    report = examine(chassis.port)
    assert report.failed == [check, "taskable"]
    assert text in report.text(check)


def test_a_robot_that_executes_a_task_rejects_another_one(chassis):
    def start(info: RobotInfo) -> None:
        info.task_proc.MergeFrom(TaskProc(robot_task_id=7, state=task.kExecuting))
        assert info.operation_state.robot & OperationState.kTaskable

    edit_bodies(chassis, RobotInfo, start)
    report = examine(chassis.port)
    assert report.failed == ["taskable"]
    assert "executing task 7 -> wait for its end, or cancel it" in report.text("taskable")


def test_an_empty_robot_info_gives_warnings(chassis):
    edit_bodies(chassis, RobotInfo, RobotInfo.Clear)
    report = examine(chassis.port)
    assert report.failed == []
    assert report.with_status(Status.WARN) == list(CHECKS[4:9])


def test_unresolved_status_codes_are_explained_and_a_pose_without_a_map_is_a_warning(chassis):
    def edit(info: RobotInfo) -> None:
        info.abnormal_codes.scs.add(code=110201000013)
        info.abnormal_codes.scs.add(code=110301000042, msg="左电机过热")
        info.pose_speed.ClearField("map_id")

    edit_bodies(chassis, RobotInfo, edit)
    report = examine(chassis.port)
    assert (report.failed, report.with_status(Status.WARN)) == (
        [],
        ["localisation", "status codes"],
    )
    assert "may mean nothing" in report.text("localisation")
    assert "110201000013: emergency stop 1 was pressed" in report.text("status codes")
    assert "110301000042: 左电机过热 (left motor is too hot)" in report.text("status codes")


def test_a_robot_that_builds_a_map_needs_no_localisation(chassis):
    def build_map(info: RobotInfo) -> None:
        info.state = robot.kMapping
        info.device_state.software = 0
        info.pose_speed.map_id = 0

    edit_bodies(chassis, RobotInfo, build_map)
    report = examine(chassis.port)
    assert report.failed == ["taskable"]
    assert "building a map" in report.text("taskable")
    assert "localisation" in report.with_status(Status.SKIPPED)
    assert "building a map" in report.text("localisation")


def test_clocks_that_differ_are_a_warning():
    with SimulatorThread(quick_config(port=0, tcp_port=0, seed=1)) as other_day:
        report = examine(other_day.port, skew=1.0)
    assert (report.failed, report.with_status(Status.WARN)) == ([], ["clock"])
    assert "behind" in report.text("clock")
    assert "days" in report.text("clock")
    assert "NTP" in report.text("clock")
    assert "stamps of ROS messages are not affected" in report.text("clock")


def test_text_and_json_have_all_checks_with_their_advice(chassis, set_state, capsys):
    set_state(
        requested_control=robot.kManual,
        work=robot.kDeployMode,
        initialised=False,
        emergency_stop=True,
    )
    assert main(["--ip", f"127.0.0.1:{chassis.port}"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"robot at ws://127.0.0.1:{chassis.port}"
    at = next(index for index, line in enumerate(lines) if line.startswith("FAIL  mode"))
    assert lines[at + 1].strip().startswith("-> turn the key switch")
    assert any(
        line.startswith("skip  initialisation") for line in lines
    )  # hidden by the stop button
    assert main(["--ip", f"127.0.0.1:{chassis.port}", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["address"], found["ok"]) == (f"ws://127.0.0.1:{chassis.port}", False)
    assert tuple(check["check"] for check in found["checks"]) == (*CHECKS, "subscribers")
    mode = found["checks"][CHECKS.index("mode")]
    assert mode["status"] == "fail"
    assert "manual" in mode["text"]
    assert "deployment" in mode["text"]  # one check can have several reasons
    assert mode["remedy"].startswith("turn the key switch")
