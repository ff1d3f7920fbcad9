"""Requests over HTTP, on the port of the WebSocket, as public programs send them."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from tests.simulator.sim_wire import TIMEOUT, Json, JsonClient
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.protocol.dispatch import HANDLERS
from woosh_robot_agent.testing import wait_until

MODE = "woosh.robot.Mode"
OCCUPY = "woosh.robot.SetOccupancy"
MIB = 1024 * 1024


class HttpClient:
    """A connection that is kept between requests, as by a session of `requests`."""

    def __init__(self, simulator: SimulatorThread) -> None:
        self.simulator = simulator
        self.connection = http.client.HTTPConnection("127.0.0.1", simulator.port, timeout=TIMEOUT)

    def send(self, name: str, body: Json | str | None = None, **headers: str) -> None:
        data = json.dumps(body) if isinstance(body, dict) else body
        path = "/" + name.replace(".", "/")
        self.connection.request("POST", path, data, {"Content-Type": "application/json", **headers})

    def receive(self) -> tuple[int, Json]:
        response = self.connection.getresponse()
        content = response.read()
        assert response.headers.get_content_type() == "application/json"
        return response.status, json.loads(content)

    def post(self, name: str, body: Json | str | None = None, **headers: str) -> tuple[int, Json]:
        self.send(name, body, **headers)
        return self.receive()

    def ask(self, name: str, body: Json | str | None = None) -> Json:
        """Return the body of the answer, which must be ok."""
        status, answer = self.post(name, body)
        assert (status, answer["ok"]) == (200, True), answer
        found: Json = answer["body"]
        return found

    def close(self) -> None:
        self.connection.close()


@pytest.fixture
def web(simulator: SimulatorThread) -> Iterator[HttpClient]:
    with closing(HttpClient(simulator)) as client:
        yield client


def test_each_request_is_answered_as_over_the_websocket(
    web: HttpClient, client: JsonClient
) -> None:
    for name in HANDLERS:
        status, answer = web.post(name, {})
        other = client.request(name)
        assert status == 200
        assert [answer[key] for key in ("type", "ok", "msg")] == [
            other[key] for key in ("type", "ok", "msg")
        ]
        assert set(answer["body"]) == set(other["body"])


@pytest.mark.parametrize("body", [None, "", " \r\n", "{}", "null", '{"newerField": [1]}'])
def test_empty_bodies_and_unknown_fields_are_accepted(web: HttpClient, body: str | None) -> None:
    assert web.ask(MODE, body)["work"] == 2


def test_unknown_type_is_404_and_named(web: HttpClient) -> None:
    for name in ("woosh.robot.Teleport", "woosh.dispatch.robot.RobotAnyInfo", "index"):
        status, answer = web.post(name, {})
        assert (status, answer["ok"], answer["body"]) == (404, False, {})
        assert answer["msg"] == f"unknown message type {name}"


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("{", "not JSON"),
        ("speed=3", "not JSON"),
        ('{"linear" 0.2}', "line 1 column 11"),
        ('{},"type":"woosh.robot.Mode"', "not JSON"),
        ("[1]", "expected an object, got [1]"),
        ('{"linear": "fast"}', "woosh.robot.Twist: linear: 'fast' does not fit"),
        ("[" * 100_000, "not JSON"),
        ("\xff\xfe", "not UTF-8"),  # sent as Latin-1
    ],
)
def test_body_that_does_not_fit_is_400_with_the_field(
    web: HttpClient, body: str, reason: str
) -> None:
    status, answer = web.post("woosh.robot.Twist", body)
    assert (status, answer["ok"], answer["type"]) == (400, False, "woosh.robot.Twist")
    assert reason in answer["msg"]
    assert web.simulator.counts["woosh.robot.Twist"] == 0
    assert web.simulator.bad_frames == 1
    assert web.ask(MODE)["work"] == 2  # on the same connection


def test_client_that_waits_before_it_sends_the_body_is_told_to_go_on(
    simulator: SimulatorThread,
) -> None:
    with socket.create_connection(("127.0.0.1", simulator.port), timeout=TIMEOUT) as client:
        head = "POST /woosh/robot/Mode HTTP/1.1\r\nHost: x\r\nExpect: 100-continue\r\n"
        client.sendall(f"{head}Content-Length: 2\r\n\r\n".encode())
        assert client.recv(4096) == b"HTTP/1.1 100 Continue\r\n\r\n"
        client.sendall(b"{}")
        assert client.recv(65536).startswith(b"HTTP/1.1 200 OK\r\n")


def test_raw_push_does_not_end_a_call(web: HttpClient) -> None:
    web.simulator.inject("delay", seconds=0.5, type=MODE)
    web.send(MODE, {})
    wait_until(lambda: web.simulator.counts[MODE] == 1)
    web.simulator.send_raw('{"type": "woosh.robot.Mode", "body": {}}')
    status, answer = web.receive()
    assert (status, answer["ok"]) == (200, True)


def test_connection_is_kept(web: HttpClient) -> None:
    web.ask(MODE)
    before = web.connection.sock
    for _ in range(5):
        web.ask(MODE)
    assert web.connection.sock is before


def test_chunked_bodies_credentials_and_other_content_types_are_accepted(web: HttpClient) -> None:
    chunks = iter([b'{"occ', b'upy": ', b"true}"])
    web.connection.request(
        "POST",
        "/woosh/robot/SetOccupancy",
        chunks,
        {"Authorization": "Basic dXNlcjpwYXNz", "Content-Type": "text/plain"},
        encode_chunked=True,
    )
    assert web.receive()[1]["ok"]
    assert web.ask("woosh.robot.DeviceState")["software"] & 8


@pytest.mark.chassis(speed=1, max_frame=20 * MIB)
def test_large_bodies_pass_and_too_large_ones_are_413(web: HttpClient) -> None:
    assert web.ask("woosh.robot.Speak", {"text": "x" * (15 * MIB)}) == {}
    sent: Any = web.simulator.last("woosh.robot.Speak")
    assert len(sent.text) == 15 * MIB
    status, answer = web.post("woosh.robot.Speak", '{"text": "' + "x" * (20 * MIB) + '"}')
    assert (status, answer["ok"]) == (413, False)
    assert "more than 20971520 bytes" in answer["msg"]
    assert web.ask(MODE)["work"] == 2


def test_get_says_what_this_is(web: HttpClient) -> None:
    for path in ("/", "/woosh/robot/PoseSpeed"):
        web.connection.request("GET", path)
        response = web.connection.getresponse()
        text = response.read().decode()
        assert (response.status, response.headers.get_content_type()) == (200, "text/plain")
        assert "simulated chassis" in text
        assert f"http://127.0.0.1:{web.connection.port}/woosh/robot/PoseSpeed" in text
    web.connection.request("HEAD", "/")
    response = web.connection.getresponse()
    assert (response.status, response.read()) == (200, b"")
    web.connection.request("PUT", "/woosh/robot/Mode", "{}")
    status, answer = web.receive()
    assert (status, answer["msg"]) == (405, "only POST and GET")


def test_foreign_web_pages_are_refused(web: HttpClient) -> None:
    """A browser sends such a request without asking the server first."""
    web.connection.request(
        "POST", "/woosh/robot/SetOccupancy", "{}", {"Origin": "https://somewhere.example"}
    )
    response = web.connection.getresponse()
    response.read()
    assert response.status == 403
    assert web.simulator.counts[OCCUPY] == 0
    assert web.post(MODE, {}, Origin="http://localhost:3000")[0] == 200


@pytest.mark.chassis(speed=1, max_connections=1)
def test_calls_beyond_the_limit_of_clients_are_refused(web: HttpClient) -> None:
    assert web.ask(MODE)["work"] == 2  # the client counts only during the call
    with closing(JsonClient(web.simulator.port)) as first:
        first.ask(MODE)
        status, answer = web.post(MODE)
        assert (status, answer["msg"]) == (503, "there are already 1 clients")
    wait_until(lambda: web.simulator.connections == 0)
    assert web.ask(MODE)["work"] == 2


@pytest.mark.chassis(speed=1, max_connections=1)
def test_calls_whose_body_is_arriving_count_towards_the_limit(web: HttpClient) -> None:
    with socket.create_connection(("127.0.0.1", web.simulator.port), TIMEOUT) as slow:
        slow.sendall(
            b"POST /woosh/robot/Mode HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\n"
            b"Expect: 100-continue\r\n\r\n"
        )
        assert slow.recv(1000).startswith(b"HTTP/1.1 100 ")
        assert web.post(MODE)[0] == 503
        slow.sendall(b"{}")
        assert slow.recv(1000).startswith(b"HTTP/1.1 200 ")
    assert web.ask(MODE)["work"] == 2


def test_client_that_leaves_before_its_answer_is_forgotten(web: HttpClient) -> None:
    web.simulator.mute(MODE)
    web.send(MODE)
    web.simulator.wait_received(MODE)
    assert web.simulator.connections == 1
    web.close()
    wait_until(lambda: web.simulator.connections == 0)


def test_delay_affects_calls(client: JsonClient, web: HttpClient) -> None:
    delayed = client.simulator.inject("delay", seconds=1000.0, type=MODE)
    web.send(MODE)
    wait_until(lambda: delayed.hits)
    client.ask("woosh.robot.Battery")
    assert client.simulator.connections == 2
    client.simulator.clear_faults()
    assert web.receive()[1]["ok"]


@pytest.mark.parametrize("idle", [True, False])
def test_drop_ends_the_connections_of_calls(web: HttpClient, idle: bool) -> None:
    web.ask(MODE)
    plain = web.connection.sock
    if not idle:
        web.simulator.mute(MODE)
        web.send(MODE)
        web.simulator.wait_received(MODE, 2)
    web.simulator.inject("drop")
    try:
        assert plain.recv(1) == b""
    except ConnectionResetError:
        pass
    web.simulator.clear_faults()
    web.close()
    assert web.ask(MODE)["work"] == 2


@pytest.mark.parametrize("name", ["half_open", "freeze"])
def test_calls_wait_for_the_end_of_a_silence(web: HttpClient, name: str) -> None:
    web.ask(MODE)
    fault = web.simulator.inject(name)
    web.send(OCCUPY, {"occupy": True})
    plain = web.connection.sock
    plain.settimeout(0.3)  # no event could tell that nothing will come
    with pytest.raises(TimeoutError):
        plain.recv(1)
    assert not web.simulator.state.info.device_state.software & 8
    plain.settimeout(TIMEOUT)
    fault.clear()
    assert web.receive()[1]["ok"]
    assert web.simulator.state.info.device_state.software & 8


@pytest.mark.parametrize("name", ["garbage", "truncated", "invalid_utf8"])
def test_damaged_answers_are_no_json(web: HttpClient, name: str) -> None:
    web.simulator.inject(name, count=1)
    web.send(MODE)
    response = web.connection.getresponse()
    data = response.read()
    assert response.status == 200
    with pytest.raises(ValueError):
        json.loads(data)
    assert web.ask(MODE)["work"] == 2


@pytest.mark.parametrize(
    ("name", "options"), [("truncated", {"where": "wire"}), ("accept_then_drop", {})]
)
def test_connection_that_is_cut_ends_one_call(
    web: HttpClient, name: str, options: dict[str, str]
) -> None:
    web.simulator.inject(name, count=1, **options)
    with pytest.raises((http.client.IncompleteRead, ConnectionError)):
        web.ask(MODE)
    web.close()
    assert web.ask(MODE)["work"] == 2


def test_oversize_answer_is_valid(web: HttpClient) -> None:
    web.simulator.inject("oversize", mib=5, count=1)
    web.send(MODE)
    response = web.connection.getresponse()
    data = response.read()
    assert len(data) == 5 * MIB
    assert json.loads(data)["ok"] is True
    assert web.ask(MODE)["work"] == 2


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("answer_twice", lambda answer: answer["body"]["work"] == 2),
        ("unknown_fields", lambda answer: "fieldOfLaterFirmware" in answer["body"]),
        ("wrong_type", lambda answer: answer["type"] == "woosh.robot.Network"),
        ("wrong_sn", lambda answer: "sn" not in answer),
        ("reorder", lambda answer: answer["ok"]),
        ("refuse", lambda answer: not answer["ok"] and answer["msg"].startswith("refused by")),
    ],
)
def test_other_faults_of_answers_affect_calls(
    web: HttpClient, name: str, check: Callable[[Json], bool]
) -> None:
    fault = web.simulator.inject(name)
    status, answer = web.post(MODE)
    assert status == 200
    assert check(answer)
    assert fault.hits == 1
    fault.clear()
    assert web.ask(MODE)["work"] == 2


def test_requests_that_are_no_http_are_ended_and_disturb_nobody(web: HttpClient) -> None:
    for junk in (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(500), b"hello\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", web.simulator.port), TIMEOUT) as other:
            other.sendall(junk)
            while other.recv(1000):
                pass
    assert web.ask(MODE)["work"] == 2
