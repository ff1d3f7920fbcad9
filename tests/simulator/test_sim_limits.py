"""Limits set on the command line."""

from __future__ import annotations

import pytest
from websockets.exceptions import ConnectionClosed

from tests.simulator.sim_wire import JsonClient, TcpClient
from tests.simulator.test_sim_program import running
from woosh_robot_agent.simulator.__main__ import main

MODE = "woosh.robot.Mode"


@pytest.mark.parametrize(
    "option", ["--max-frame", "--max-connections", "--max-waiting", "--max-outbox"]
)
def test_limits_must_be_at_least_one(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([option, "0"])
    assert f"{option[2:].replace('-', '_')} 0 is not at least 1" in capsys.readouterr().err


def test_frame_size_and_connections_are_limited() -> None:
    with running("--max-frame", "1000", "--max-connections", "1") as (_, port, tcp_port):
        client = JsonClient(port)
        client.ask(MODE)
        second = TcpClient(tcp_port)
        with pytest.raises((AssertionError, ConnectionError)):
            second.request(MODE)
        second.close()
        client.send({"type": MODE, "body": {}, "sn": 1, "padding": "x" * 1000})
        with pytest.raises(ConnectionClosed):
            client.receive()
        client.close()


def test_waiting_requests_are_limited() -> None:
    with running("--max-waiting", "2", "--fault", "delay seconds=3600") as (_, port, _):
        client = JsonClient(port)
        for sn in range(1, 4):
            client.send({"type": MODE, "sn": sn})
        answer = client.receive()
        assert (answer["sn"], answer["ok"]) == (3, False)
        assert "2 requests of this connection are waiting" in answer["msg"]
        client.close()
