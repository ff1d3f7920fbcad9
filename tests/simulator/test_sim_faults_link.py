"""Faults of the whole connection, and behaviour common to all faults."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter

import pytest
from websockets.exceptions import ConnectionClosed

from tests.asynchronous import eventually
from tests.quick_chassis import quick_config
from tests.simulator.sim_wire import TIMEOUT, Connect, ConnectTcp, JsonClient, TcpClient, packed
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.simulator import FaultError, SimulatedChassis, SimulatorThread
from woosh_robot_agent.testing import wait_until

MODE = "woosh.robot.Mode"
OCCUPY = "woosh.robot.SetOccupancy"
UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: here\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def plain_socket(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), TIMEOUT)


def test_accept_then_drop_closes_new_connections_only(
    client: JsonClient, connect: Connect, connect_tcp: ConnectTcp
) -> None:
    client.ask(MODE)
    fault = client.simulator.inject("accept_then_drop", count=2)
    new = connect()  # the handshake still succeeds
    with pytest.raises(ConnectionClosed):
        new.receive()
    with plain_socket(client.simulator.tcp_port) as tcp:
        assert tcp.recv(1) == b""
    wait_until(lambda: not fault.active)
    assert fault.hits == 2
    assert connect_tcp().request(MODE).ok
    client.ask(MODE)  # older connections stay open
    assert client.simulator.counts[MODE] == 3


def test_off_refuses_connections_and_returns_to_the_same_ports(
    tcp: TcpClient, connect: Connect, connect_tcp: ConnectTcp
) -> None:
    ports = tcp.simulator.port, tcp.simulator.tcp_port
    assert tcp.request(MODE).ok
    fault = tcp.simulator.inject("off")
    with pytest.raises(ConnectionError):
        tcp.receive()
    for port in ports:
        with pytest.raises(ConnectionRefusedError):
            plain_socket(port)
        with socket.socket() as other, pytest.raises(OSError, match="in use"):
            other.bind(("127.0.0.1", port))
    fault.clear()
    assert (tcp.simulator.port, tcp.simulator.tcp_port) == ports
    connect().ask(MODE)
    assert connect_tcp().request(MODE).ok


def test_half_open_connections_get_no_data_until_cleared(
    client: JsonClient, tcp: TcpClient
) -> None:
    client.ask(MODE)
    fault = client.simulator.inject("half_open")
    client.send({"type": OCCUPY, "body": {"occupy": True}, "sn": 900})
    pong = client.complete(client.socket.ping())
    with (
        plain_socket(client.simulator.port) as websocket,
        plain_socket(client.simulator.tcp_port) as new,
    ):
        websocket.sendall(UPGRADE)
        request = packed(MODE, sn=5)
        new.sendall(bytes([len(request)]) + request)
        for silent in (websocket, new):
            silent.settimeout(0.2)  # no event could tell that nothing will come
            with pytest.raises(TimeoutError):
                silent.recv(1)
        client.assert_silent(0.05)
        assert not pong.done()
        assert client.simulator.counts[OCCUPY] == 0
        assert not client.simulator.state.info.device_state.software & 8
        fault.clear()
        for silent, begin in ((websocket, b"HTTP/1.1 101"), (new, b"")):
            silent.settimeout(TIMEOUT)
            assert silent.recv(12).startswith(begin)
    assert client.receive()["sn"] == 900
    client.complete(pong)
    assert client.simulator.counts[OCCUPY] == 1


def test_freeze_stops_clock_and_answers_but_not_pongs(client: JsonClient, tcp: TcpClient) -> None:
    client.subscribe("woosh.robot.Battery")
    delayed = client.simulator.inject("delay", seconds=0.1, count=1)
    client.send({"type": MODE, "sn": 900})
    wait_until(lambda: delayed.hits)
    fault = client.simulator.inject("freeze")
    client.simulator.push(robot_pb2.Battery(power=3))
    elapsed = client.simulator.state.elapsed
    client.send({"type": OCCUPY, "body": {"occupy": True}, "sn": 901})
    client.send({"type": OCCUPY, "body": {"occupy": False}, "sn": 902})
    client.send({"type": "no such type", "sn": 903})
    tcp.send(packed(MODE, sn=904))
    client.simulator.wait_received(OCCUPY, 2)
    client.simulator.wait_received(MODE, 3)
    client.assert_silent(0.2)  # neither pushes nor the delayed answer leave it
    client.complete(client.complete(client.socket.ping()))
    assert client.simulator.state.elapsed == elapsed
    assert not client.simulator.state.info.device_state.software & 8
    fault.clear()
    frames = [client.receive() for _ in range(5)]
    oks = {frame["sn"]: frame["ok"] for frame in frames if "sn" in frame}
    assert oks == {900: True, 901: True, 902: True, 903: False}
    assert [sn for sn in oks if sn != 900] == [901, 902, 903]
    assert tcp.receive().sn == 904
    assert client.simulator.counts[OCCUPY] == 2
    wait_until(lambda: client.simulator.state.elapsed > elapsed)
    # Its duration elapses although the simulated time stands still.
    fault = client.simulator.inject("freeze", for_=10.0)
    assert client.request(MODE)["ok"]
    assert not fault.active


def test_overlapping_faults_last_until_the_last_is_cleared(client: JsonClient) -> None:
    frozen = client.simulator.inject("freeze")
    held = [client.simulator.inject("half_open") for _ in range(2)]
    client.send({"type": MODE, "sn": 3})
    held[0].clear()
    held[0].clear()  # has no effect
    client.assert_silent(0.1)
    assert client.simulator.counts[MODE] == 0
    held[1].clear()
    client.simulator.wait_received(MODE)
    client.assert_silent(0.1)
    frozen.clear()
    assert client.receive()["sn"] == 3
    assert client.simulator.injected["half_open"] == 2


INVALID: list[tuple[str, dict[str, object], str]] = [
    ("dorp", {}, "unknown fault 'dorp': use one of emergency_stop, "),
    ("delay", {"second": 1}, "delay has no argument 'second'; its arguments are: seconds, "),
    ("delay", {"seconds": "1"}, "delay: seconds: '1' is not a number from 0 to 86400, in s of"),
    ("delay", {"seconds": -1}, "seconds: -1 is not"),
    ("delay", {"seconds": float("nan")}, "seconds: nan is not"),
    ("delay", {"seconds": 10**400}, "is not a number from 0 to 86400"),
    ("delay", {"count": 10**400}, "is not an integer of at least 0"),
    ("delay", {"for_": float("inf")}, "for: inf is not a number of at least 0, in s"),
    ("delay", {"count": 1.5}, "count: 1.5 is not an integer of at least 0"),
    ("delay", {"count": True}, "count: True is not an integer"),
    ("delay", {"frames": "some"}, "frames: 'some' is not answers or pushes or all"),
    ("refuse", {"text": 5}, "text: 5 is not a text"),
    ("refuse", {"type": "woosh.robot.Speek"}, "no message has the type 'woosh.robot.Speek'"),
    ("drop", {"for_": 1}, "drop is momentary: leave out `for`"),
    ("obstacle", {"x": 1.0}, "give both x and y"),
    ("burst", {"type": "woosh.robot.Speak"}, "is not one of"),
]


def test_invalid_faults_are_refused_with_a_hint(simulator: SimulatorThread) -> None:
    for name, arguments, complaint in INVALID:
        with pytest.raises(FaultError) as error:
            simulator.inject(name, **arguments)
        assert complaint in str(error.value)
    assert simulator.injected == Counter()
    assert simulator.faults == []


def test_faults_work_in_the_event_loop_of_the_caller() -> None:
    async def scenario() -> None:
        config = quick_config(port=0, tcp_port=0, speed=100)
        async with SimulatedChassis(config) as simulator:
            fault = simulator.inject("off")
            await simulator.settle()
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection("127.0.0.1", simulator.tcp_port)
            fault.clear()
            await simulator.settle()
            _, writer = await asyncio.open_connection("127.0.0.1", simulator.tcp_port)
            writer.close()
            simulator.inject("half_open")
            simulator.inject("freeze")
            simulator.inject("off")  # the simulator can still shut down

    asyncio.run(scenario())


def test_off_also_drops_a_client_that_connects_before_the_ports_close() -> None:
    async def scenario() -> None:
        async with SimulatedChassis(quick_config(port=0, tcp_port=0)) as simulator:
            async with simulator._changing:  # an earlier change takes its time
                simulator.inject("off")
                _, writer = await asyncio.open_connection("127.0.0.1", simulator.tcp_port)
                await eventually(lambda: simulator.connections, "the client")
            await simulator.settle()
            await eventually(lambda: not simulator.connections, "the end of the connection", 10.0)
            writer.close()

    asyncio.run(scenario())
