"""Faults of requests and answers, as a client sees them."""

from __future__ import annotations

import pytest

from tests.simulator.sim_wire import JsonClient, TcpClient, connected, packed, subscription
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.testing import wait_until

MODE = "woosh.robot.Mode"
BATTERY = "woosh.robot.Battery"
OCCUPY = "woosh.robot.SetOccupancy"
OCCUPIED = 8  # the bit in DeviceState.software
HOUR = 3600.0


def answer_order(client: JsonClient, count: int) -> list[int]:
    """Send requests in a row and return the serial numbers of the answers as they arrive."""
    for sn in range(1, count + 1):
        client.send({"type": MODE, "sn": sn})
    return [client.receive()["sn"] for _ in range(count)]


def test_refuse_answers_with_its_text(client: JsonClient, tcp: TcpClient) -> None:
    everything = client.simulator.inject("refuse", text="out of order")
    client.simulator.inject("refuse", type=OCCUPY, text="今天不行", count=1)
    # The newest fault takes precedence, and ends after one request.
    assert client.refusal(OCCUPY, {"occupy": True}) == "今天不行"
    assert client.refusal(OCCUPY, {"occupy": True}) == "out of order"
    answer = tcp.request(MODE)
    assert (answer.ok, answer.msg, answer.type) == (False, "out of order", MODE)
    everything.clear()
    assert not client.ask("woosh.robot.DeviceState")["software"] & OCCUPIED
    assert client.simulator.counts[OCCUPY] == 2
    assert everything.hits == 2
    # Other types are not refused.
    client.simulator.inject("refuse", type=OCCUPY)
    client.ask(MODE)
    assert client.refusal(OCCUPY) == "refused by the simulator"


def test_delay_applies_to_pushes(client: JsonClient) -> None:
    client.subscribe(BATTERY, MODE)
    client.simulator.inject("delay", seconds=0.3, frames="pushes", type=BATTERY)
    client.simulator.push(robot_pb2.Battery(power=3))
    client.simulator.push(robot_pb2.Mode())
    assert [client.receive()["type"] for _ in range(2)] == [MODE, BATTERY]


def test_equal_seeds_give_equal_faults() -> None:
    seen = []
    for _ in range(2):
        with connected(seed=5) as client:
            fault = client.simulator.inject("delay", seconds=0.0, jitter=HOUR)
            for sn in range(1, 11):
                client.send({"type": MODE, "sn": sn})
            wait_until(lambda fault=fault: fault.hits == 10)
            client.simulator.clear_faults()  # releases the answers in the order of their delays
            delayed = [client.receive()["sn"] for _ in range(10)]
            client.simulator.inject("reorder", window=5, seconds=HOUR)
            reordered = answer_order(client, 15)
            client.simulator.clear_faults()
            client.simulator.inject("wrong_field_type")
            kinds = [type(value) for value in client.request(BATTERY)["body"].values()]
            client.simulator.inject("garbage")
            client.send({"type": MODE, "sn": 1})
            seen.append((delayed, reordered, kinds, client.complete(client.socket.recv())))
    assert seen[0] == seen[1]
    assert sorted(delayed) == list(range(1, 11)) != delayed
    for begin in (0, 5, 10):
        group = reordered[begin : begin + 5]
        assert sorted(group) == list(range(begin + 1, begin + 6)) != group


def test_reorder_releases_frames_on_timeout_and_on_clear(client: JsonClient) -> None:
    fault = client.simulator.inject("reorder", window=100, seconds=0.1)
    assert sorted(answer_order(client, 3)) == [1, 2, 3]
    fault.clear()
    fault = client.simulator.inject("reorder", window=100, seconds=HOUR)
    client.send({"type": MODE, "sn": 9})
    wait_until(lambda: fault.hits == 1)
    fault.clear()
    assert client.receive()["sn"] == 9


def test_reorder_treats_each_client_separately(client: JsonClient, tcp: TcpClient) -> None:
    fault = client.simulator.inject("reorder", window=2, seconds=HOUR)
    client.send({"type": MODE, "sn": 1})
    tcp.send(packed(MODE, sn=3))
    wait_until(lambda: fault.hits == 2)
    client.send({"type": MODE, "sn": 2})
    assert [client.receive()["sn"] for _ in range(2)] == [2, 1]
    tcp.send(packed(MODE, sn=4))
    assert [tcp.receive().sn for _ in range(2)] == [4, 3]


def test_lose_answer_executes_the_request(client: JsonClient) -> None:
    client.simulator.inject("lose_answer", type=OCCUPY, count=1)
    client.send({"type": OCCUPY, "body": {"occupy": True}, "sn": 500})
    assert client.ask("woosh.robot.DeviceState")["software"] & OCCUPIED  # the request was executed
    client.ask(OCCUPY, {"occupy": False})
    assert client.simulator.counts[OCCUPY] == 2


def test_answer_twice_executes_the_request_once(client: JsonClient, tcp: TcpClient) -> None:
    client.simulator.inject("answer_twice")
    client.send({"type": OCCUPY, "body": {"occupy": True}, "sn": 500})
    first, second = client.receive(), client.receive()
    assert first == second
    assert first["sn"] == 500
    tcp.send(packed(MODE, sn=7))
    assert tcp.receive() == tcp.receive()
    assert client.simulator.counts[OCCUPY] == 1  # executed once


def test_wrong_sn_shifts_the_serial_number(client: JsonClient) -> None:
    for by, sn, wrong in ((1, 4, 5), (1, 2**31 - 1, 1), (10, 2**31 - 5, 6)):
        client.simulator.inject("wrong_sn", by=by, count=1)
        client.send({"type": MODE, "sn": sn})
        assert client.receive()["sn"] == wrong
        client.send({"type": MODE, "sn": sn})
        assert client.receive()["sn"] == sn


def test_hook_replaces_the_earlier_one_of_its_kind(client: JsonClient) -> None:
    client.simulator.delay(BATTERY, HOUR)
    client.simulator.delay(BATTERY, 0.01)
    client.simulator.refuse(BATTERY, "no")
    client.simulator.refuse(BATTERY, "never")
    assert client.refusal(BATTERY) == "never"
    assert [fault.name for fault in client.simulator.faults] == ["delay", "refuse"]
    client.simulator.accept(BATTERY)
    client.ask(BATTERY)
    assert client.simulator.faults == []


@pytest.mark.chassis(speed=1, max_waiting=3)
def test_waiting_requests_of_a_connection_are_limited(client: JsonClient, tcp: TcpClient) -> None:
    client.simulator.inject("delay", seconds=HOUR)
    for sn in range(1, 6):
        client.send({"type": OCCUPY, "body": {"occupy": True}, "sn": sn})
    refused = [client.receive() for _ in range(2)]
    assert [answer["sn"] for answer in refused] == [4, 5]
    for answer in refused:
        assert (answer["type"], answer["ok"]) == (OCCUPY, False)
        assert "3 requests of this connection are waiting" in answer["msg"]
    assert client.simulator.counts[OCCUPY] == 5
    tcp.send(packed(MODE, sn=1))  # each connection has its own limit
    client.simulator.wait_received(MODE)
    client.simulator.clear_faults()
    assert [client.receive()["sn"] for _ in range(3)] == [1, 2, 3]
    assert tcp.receive().ok
    client.ask(MODE)
    # Answers that wait for a client go with it.
    client.simulator.inject("delay", seconds=HOUR)
    tcp.send(packed(MODE, sn=2))
    client.simulator.wait_received(MODE, 3)
    tcp.close()
    wait_until(lambda: client.simulator.connections == 1)
    client.simulator.clear_faults()
    client.ask(MODE)


@pytest.mark.chassis(speed=1, max_waiting=2)
def test_waiting_requests_of_a_frozen_chassis_are_limited(
    client: JsonClient, tcp: TcpClient
) -> None:
    client.simulator.inject("freeze")
    for sn in range(1, 5):
        client.send({"type": MODE, "sn": sn})
    for _ in range(3):  # subscriptions have no answer, so the connection is closed
        tcp.send(subscription(MODE))
    client.simulator.wait_received(MODE, 4)
    with pytest.raises(ConnectionError):
        tcp.receive()
    client.simulator.clear_faults()
    answers = [client.receive() for _ in range(4)]
    oks = {answer["sn"]: answer["ok"] for answer in answers}
    assert oks == {1: True, 2: True, 3: False, 4: False}
    client.ask(MODE)
