"""Lights and the radio remote controller."""

from __future__ import annotations

import pytest

from tests.simulator.sim_wire import JsonClient
from woosh_robot_agent.pb.robot.robot_pack_pb2 import LED
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import wait_until

LIGHT, REMOTE = "woosh.robot.LED", "woosh.device.RfRemoteController"


def test_lights_are_kept_by_submodule(client: JsonClient) -> None:
    assert client.simulator.state.lights == {}
    red = {"submodule": 0, "urgency": 1, "abnormal": 2, "normal": 3, "color": 0xFF0000}
    answer = client.request(LIGHT, red)
    assert (answer["type"], answer["ok"], answer["body"]) == (LIGHT, True, red)
    client.ask(LIGHT, {"submodule": 2, "color": 7})
    client.ask(LIGHT, {"submodule": 2, "color": 8})
    assert client.simulator.state.lights == {0: LED(**red), 2: LED(submodule=2, color=8)}


def test_keys_of_the_remote_controller_are_pushed_when_they_change(client: JsonClient) -> None:
    client.subscribe(REMOTE)
    assert client.ask(REMOTE) == {"address": 0, "keys": 0}
    client.simulator.hold_remote_keys(0b101, address=7)
    assert client.next_push(REMOTE) == {"address": 7, "keys": 5}
    assert client.ask(REMOTE) == {"address": 7, "keys": 5}
    assert client.simulator.state.remote_keys == 5
    client.simulator.hold_remote_keys(0b101, address=7)
    client.simulator.hold_remote_keys(0, address=7)
    assert client.next_push(REMOTE) == {"address": 7, "keys": 0}
    assert client.take_pushes(REMOTE) == []


def test_keys_of_the_fault_are_released_at_its_end(client: JsonClient) -> None:
    client.subscribe(REMOTE)
    client.simulator.inject("remote_keys", keys=2, address=3, for_=5)
    assert client.next_push(REMOTE) == {"address": 3, "keys": 2}
    assert client.next_push(REMOTE) == {"address": 3, "keys": 0}
    wait_until(lambda: not client.simulator.faults)


def test_keys_beyond_32_bits_are_an_error(simulator: SimulatorThread) -> None:
    with pytest.raises(ValueError, match="out of range"):
        simulator.hold_remote_keys(2**32)
    assert simulator.state.remote_keys == 0
