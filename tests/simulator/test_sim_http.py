"""Requests over HTTP, on the port of the WebSocket, as public programs send them."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from tests.quick_chassis import quick_config
from tests.simulator.sim_wire import TIMEOUT, Json, JsonClient
from woosh_robot_agent.simulator import SimulatedChassis, SimulatorThread
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
    for name in (MODE, "woosh.robot.RobotInfo", "woosh.map.Download", "woosh.robot.ExecTask"):
        status, answer = web.post(name, {})
        other = client.request(name)
        assert status == 200
        assert [answer[key] for key in ("type", "ok", "msg")] == [
            other[key] for key in ("type", "ok", "msg")
        ]
        assert set(answer["body"]) == set(other["body"])


def test_empty_bodies_and_unknown_fields_are_accepted_on_one_connection(web: HttpClient) -> None:
    web.ask(MODE)
    before = web.connection.sock
    for body in ("", " \r\n", "{}", "null", '{"newerField": [1]}'):
        assert web.ask(MODE, body)["work"] == 2
    assert web.connection.sock is before


def test_unknown_type_is_404_and_named(web: HttpClient) -> None:
    for name in ("woosh.robot.Teleport", "woosh.dispatch.robot.RobotAnyInfo", "index"):
        status, answer = web.post(name, {})
        assert (status, answer["ok"], answer["body"]) == (404, False, {})
        assert answer["msg"] == f"unknown message type {name}"


BAD_BODIES = {
    "{": "not JSON",
    '{"linear" 0.2}': "line 1 column 11",
    '{},"type":"woosh.robot.Mode"': "not JSON",
    "[1]": "expected an object, got [1]",
    '{"linear": "fast"}': "woosh.robot.Twist: linear: 'fast' does not fit",
    "[" * 100_000: "not JSON",
    "\xff\xfe": "not UTF-8",  # sent as Latin-1
}


def test_body_that_does_not_fit_is_400_with_the_field(web: HttpClient) -> None:
    for body, reason in BAD_BODIES.items():
        status, answer = web.post("woosh.robot.Twist", body)
        assert (status, answer["ok"], answer["type"]) == (400, False, "woosh.robot.Twist")
        assert reason in answer["msg"]
    assert web.simulator.counts["woosh.robot.Twist"] == 0
    assert web.simulator.bad_frames == len(BAD_BODIES)
    assert web.ask(MODE)["work"] == 2  # on the same connection


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


@pytest.mark.chassis(speed=1, max_frame=3 * MIB)
def test_large_bodies_pass_and_too_large_ones_are_413(web: HttpClient) -> None:
    assert web.ask("woosh.robot.Speak", {"text": "x" * (2 * MIB)}) == {}
    sent: Any = web.simulator.last("woosh.robot.Speak")
    assert len(sent.text) == 2 * MIB
    status, answer = web.post("woosh.robot.Speak", '{"text": "' + "x" * (3 * MIB) + '"}')
    assert (status, answer["ok"]) == (413, False)
    assert "more than 3145728 bytes" in answer["msg"]
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
    # A call counts while its body arrives.
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


def test_drop_ends_the_connections_of_calls(web: HttpClient, simulator: SimulatorThread) -> None:
    with closing(HttpClient(simulator)) as idle:
        idle.ask(MODE)
        web.send(MODE)
        web.receive()
        simulator.mute(MODE)
        web.send(MODE)
        simulator.wait_received(MODE, 3)
        simulator.inject("drop")
        for each in (idle, web):
            with contextlib.suppress(ConnectionResetError):
                assert each.connection.sock.recv(1) == b""
    simulator.clear_faults()
    web.close()
    assert web.ask(MODE)["work"] == 2


def test_the_wait_for_the_last_client_ends_with_a_call() -> None:
    async def scenario() -> None:
        async with SimulatedChassis(quick_config(port=0, tcp_port=0)) as simulator:
            simulator.mute(MODE)
            _, writer = await asyncio.open_connection("127.0.0.1", simulator.port)
            writer.write(b"POST /woosh/robot/Mode HTTP/1.1\r\nHost: a\r\nContent-Length: 0\r\n\r\n")
            await simulator.wait_received(MODE)
            waiting = asyncio.ensure_future(simulator.wait_disconnected())
            await asyncio.sleep(0)  # it begins to wait
            writer.close()
            await asyncio.wait_for(waiting, TIMEOUT)

    asyncio.run(scenario())


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


ODD_ANSWERS: dict[str, Callable[[Json], bool]] = {
    "answer_twice": lambda answer: answer["body"]["work"] == 2,
    "oversize": lambda answer: answer["ok"],
    "unknown_fields": lambda answer: "fieldOfLaterFirmware" in answer["body"],
    "wrong_type": lambda answer: answer["type"] == "woosh.robot.Network",
    "wrong_sn": lambda answer: "sn" not in answer,
    "reorder": lambda answer: answer["ok"],
    "refuse": lambda answer: not answer["ok"] and answer["msg"].startswith("refused by"),
}
"""Faults of answers that a call can read, and what shows them."""


def test_other_faults_of_answers_affect_calls(web: HttpClient) -> None:
    for name, shows in ODD_ANSWERS.items():
        fault = web.simulator.inject(name, **({"mib": 5} if name == "oversize" else {}))
        status, answer = web.post(MODE)
        assert status == 200
        assert shows(answer), name
        assert fault.hits == 1
        fault.clear()
        assert web.ask(MODE)["work"] == 2
