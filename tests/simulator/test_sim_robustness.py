"""Many clients, bad frames, and the simulator's hooks for tests."""

from __future__ import annotations

import asyncio
import dataclasses
import socket
from collections.abc import Iterable
from contextlib import closing

import pytest

from tests.simulator.sim_wire import (
    ConnectTcp,
    JsonClient,
    TcpClient,
    pass_time,
    subscription,
)
from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pb2
from woosh_robot_agent.simulator import Outgoing, SimulatorThread

GARBAGE: list[str | bytes] = [
    "",
    "garbage",
    "[1, 2]",
    "{}",
    '{"type": 5}',
    '{"type": "woosh.robot.Mode", "sn": "x"}',
    '{"type": "woosh.Subscription", "body": {"topics": 5}}',
    "[" * 100_000,
    b"",
    b"\xff\xff\xff\xff",
    b"\x00" * 1000,
]


def test_bad_frames_are_skipped(client: JsonClient) -> None:
    for frame in GARBAGE:
        client.send(frame)
    assert client.ask("woosh.robot.Mode")["ctrl"] == 1
    assert client.simulator.bad_frames == len(GARBAGE)
    assert client.simulator.connections == 1


def test_bad_frames_over_tcp_are_skipped(tcp: TcpClient) -> None:
    for frame in (b"\xff\xff", b"", b"{}"):
        tcp.send(frame)
    assert tcp.request("woosh.robot.Mode").ok
    with socket.create_connection(("127.0.0.1", tcp.simulator.tcp_port)) as other:
        other.sendall(b"\xff" * 20)  # a varint that never ends
        other.settimeout(5)
        assert other.recv(1) == b""
    assert tcp.request("woosh.robot.Mode").ok


@pytest.mark.chassis(speed=1, max_outbox=5)
def test_slow_client_is_dropped_and_delays_no_other(
    simulator: SimulatorThread, connect_tcp: ConnectTcp
) -> None:
    slow, quick = connect_tcp(), connect_tcp()
    assert quick.request("woosh.robot.Mode").ok
    slow.send(subscription("woosh.robot.count.StatusCode"))
    simulator.wait_received("woosh.Subscription")
    while simulator.connections > 1:  # `slow` never reads
        simulator.push(robot_count_pb2.StatusCode(msg="x" * 1_000_000))
        assert quick.request("woosh.robot.Mode").ok


def test_received_messages_are_recorded(client: JsonClient) -> None:
    assert client.simulator.last("woosh.robot.Twist") is None
    client.subscribe("woosh.robot.Mode")
    client.ask("woosh.robot.Twist", {"linear": 0.25})
    message = client.simulator.wait_received("woosh.robot.Twist")
    assert message == client.simulator.last("woosh.robot.Twist")
    assert getattr(message, "linear", None) == 0.25
    assert client.simulator.counts["woosh.Subscription"] == 1
    types = [each.type for each in client.simulator.received]
    assert types == ["woosh.Subscription", "woosh.robot.Mode", "woosh.robot.Twist"]
    with pytest.raises(asyncio.TimeoutError):
        client.simulator.wait_received("woosh.robot.Twist", count=2, timeout=0.01)


def test_interceptor_can_change_and_add_frames(client: JsonClient) -> None:
    def wrong_then_right(frame: Outgoing) -> Iterable[Outgoing]:
        yield dataclasses.replace(frame, sn=frame.sn + 1000)
        yield frame

    remove = client.simulator.intercept(wrong_then_right)
    client.send({"type": "woosh.robot.Mode", "sn": 3})
    assert [client.receive()["sn"] for _ in range(2)] == [1003, 3]
    remove()
    client.send({"type": "woosh.robot.Mode", "sn": 4})
    client.send({"type": "woosh.robot.Mode", "sn": 5})
    assert [client.receive()["sn"] for _ in range(2)] == [4, 5]


def test_failing_interceptor_closes_no_connection(client: JsonClient) -> None:
    def fail(frame: Outgoing) -> Iterable[Outgoing]:
        raise RuntimeError("on purpose")

    client.subscribe("woosh.robot.PoseSpeed")
    remove = client.simulator.intercept(fail)
    client.send({"type": "woosh.robot.Twist", "body": {"linear": 0.5}, "sn": 800})
    client.simulator.wait_received("woosh.robot.Twist")
    pass_time(client.simulator, 0.2)
    remove()
    client.send({"type": "woosh.robot.Twist", "body": {"linear": 0.5}, "sn": 801})
    client.next_push("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.Mode")


def test_raw_frames_and_pushes_can_be_sent(client: JsonClient) -> None:
    client.subscribe("woosh.robot.Battery")
    client.simulator.push(robot_pb2.Battery(power=3))
    assert client.next_push("woosh.robot.Battery")["power"] == 3
    client.simulator.push(robot_pb2.Mode())  # no client has subscribed to it
    client.simulator.send_raw('{"type": "x"}')
    assert client.receive() == {"type": "x"}


def test_subscriptions_end_with_the_connection(client: JsonClient) -> None:
    with closing(JsonClient(client.simulator.port)) as first:
        first.subscribe("woosh.robot.Mode")
    client.ask("woosh.robot.SwitchWorkMode", {"mode": 3})
    assert client.take_pushes("woosh.robot.Mode") == []
