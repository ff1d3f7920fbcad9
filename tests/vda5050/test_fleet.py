"""Several vehicles in one process, and the example of a master that sends them round."""

from __future__ import annotations

import asyncio
import json
import logging
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, AsyncExitStack, ExitStack
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client

import woosh_robot_agent.vda5050.program as connector_program
from tests.asynchronous import TIMEOUT, eventually
from tests.quick_chassis import quick_config, set_speed
from tests.tools.dashboard.pages import page
from tests.vda5050.broker import Mosquitto, Recorder
from tests.vda5050.conftest import Site, scene_with_start
from tests.vda5050.master import START, Master, node
from tests.vda5050.programs import ROOT, running
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.mqtt import BrokerConfig
from woosh_robot_agent.vda5050.program import Connector, VehicleNameFilter
from woosh_robot_agent.vda5050.session import VehicleConfig

SERIALS = ("30001", "30002")


@pytest.fixture
def robots() -> Iterator[list[SimulatorThread]]:
    """Two simulated chassis."""
    with ExitStack() as stack:
        yield [
            stack.enter_context(
                SimulatorThread(quick_config(port=0, tcp_port=0, speed=20, robot_id=int(serial)))
            )
            for serial in SERIALS
        ]


def running_fleet(
    robots: list[SimulatorThread], broker: Mosquitto, folder: Path, *options: str
) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Run the connector in a block, for the robots that the parameter file of an agent lists."""
    names = [f"r{number}" for number, _ in enumerate(robots, 1)]
    sections: dict[str, Any] = {"/**": {"robots": [f"/{name}" for name in names]}}
    for name, robot in zip(names, robots, strict=True):
        sections[f"/{name}/agent"] = {"ip": "127.0.0.1", "port": robot.port, "publish_tf": True}
    file = folder / "robots.yaml"
    # JSON is valid YAML
    file.write_text(json.dumps({name: {"ros__parameters": of} for name, of in sections.items()}))
    arguments = ("-m", "woosh_robot_agent.vda5050", "--robots", file, "--broker", broker.url)
    return running(*arguments, *options, log=folder / "connector.log")


async def test_a_file_lists_the_robots_of_the_program_whose_orders_the_page_shows(
    robots: list[SimulatorThread], broker: Mosquitto, recorder: Recorder, tmp_path: Path
) -> None:
    log = tmp_path / "connector.log"
    async with AsyncExitStack() as stack:  # before the program: the first state is not retained
        masters = [
            await stack.enter_async_context(Master(broker.port, serial)) for serial in SERIALS
        ]
        with running_fleet(robots, broker, tmp_path, "--dashboard", "0") as program:
            for master in masters:
                await master.online()
            one, two = masters
            url = re.search(r"dashboard ready at (\S+)", log.read_text())
            assert url is not None
            async with page(url[1]) as viewer:
                assert not (await viewer.command("stop"))[0]  # it only shows
                one.order([node("a", 0, *START), node("c", 2, -9.5, -7.5)])
                order = await viewer.until(
                    lambda parts: (
                        parts["fleet"][0]["order"]["node"] == "c" and parts["fleet"][0]["order"]
                    )
                )
                assert order["id"] == one.state["orderId"]
                assert (order["nodesLeft"], order["errors"]) == (0, [])
                two.order([])
                errors = await viewer.until(lambda parts: parts["fleet"][1]["order"]["errors"])
                assert "the order has no node" in errors[0]["text"]["english"]
                assert errors[0]["level"] == "WARNING"
            await two.wait_state(lambda state: state["errors"])
            program.send_signal(signal.SIGINT)
            assert await eventually(lambda: program.poll() is not None)
            assert program.returncode == 0
    states = [
        (each["serialNumber"], each["connectionState"]) for each in recorder.sent("connection")
    ]
    assert sorted(states[-2:]) == [(serial, "OFFLINE") for serial in SERIALS]
    assert "WARNING: r2: an order was rejected: the order has no node" in log.read_text()


async def test_a_lost_robot_affects_only_its_own_vehicle(
    robots: list[SimulatorThread],
    broker: Mosquitto,
    recorder: Recorder,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.handler.addFilter(VehicleNameFilter())
    vehicles = {
        serial: VehicleConfig(LinkConfig(ip="127.0.0.1", port=robot.port, backoff_max=1.0))
        for serial, robot in zip(SERIALS, robots, strict=True)
    }
    vehicles["nowhere"] = VehicleConfig(LinkConfig(ip="127.0.0.1", port=9))
    connector = Connector(vehicles, BrokerConfig.from_url(broker.url))
    connector.start()
    try:
        async with (
            Master(broker.port, SERIALS[0]) as first,
            Master(broker.port, SERIALS[1]) as other,
        ):
            await first.online()
            await other.online()
            with caplog.at_level(logging.WARNING):
                robots[0].stop_listening()
                other.order([node("a", 0, *START), node("b", 2, 5.5, -6.5)])
                await other.wait_state(lambda state: state["lastNodeId"] == "b")
            assert first.last("connection")["connectionState"] != "OFFLINE"
    finally:
        await connector.close()
    concerned = {
        record.vehicle for record in caplog.records if "link" in record.getMessage().lower()
    }
    assert concerned <= {f"{SERIALS[0]}: ", "nowhere: "}, caplog.text


def test_a_broker_that_is_off_does_not_keep_all_threads_busy(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    connecting: set[object] = set()
    is_over = threading.Event()

    def connect(client: object, *arguments: object) -> None:
        connecting.add(client)
        is_over.wait(TIMEOUT)
        raise OSError

    monkeypatch.setattr(Client, "connect", connect)
    link = LinkConfig(ip="127.0.0.1", port=chassis.port)
    vehicles = {str(n): VehicleConfig(link, serial_number=str(n)) for n in range(40)}

    async def run(connector: Connector, dashboard_port: int | None) -> int:
        connector.start()
        try:
            await eventually(lambda: len(connecting) == len(vehicles))
            await asyncio.to_thread(is_over.set)  # e.g. a host name that is looked up
        finally:
            is_over.set()
            await connector.close()
        return 0

    monkeypatch.setattr(connector_program, "_vehicles", lambda parser, options: vehicles)
    monkeypatch.setattr(connector_program, "_run", run)
    assert connector_program.main(["--broker", "mqtt://broker"]) == 0


async def test_the_state_may_go_out_while_driving_and_without_maps(site: Site) -> None:
    set_speed(site.chassis, 2.0)
    limits = Limits(driving_state_interval=0.2, maps_in_state=False)
    async with site.online(limits=limits) as master:
        master.order([node("a", 0, *START), node("b", 2, 9.0, -7.5)])
        await master.reached("b")
    states = site.recorder.sent("state")
    places = {state["agvPosition"]["x"] for state in states if state["driving"]}
    assert len([x for x in places if START[0] + 0.5 < x < 8.5]) >= 3, places
    assert all("maps" not in state for state in states)


async def test_the_example_master_sends_vehicles_round_one_on_each_node(
    broker: Mosquitto, recorder: Recorder, tmp_path: Path
) -> None:
    with ExitStack() as stack:
        script = ROOT / "docs/examples/fleet_master.py"
        poses = subprocess.run(
            [sys.executable, script, "--starts", "2"], check=True, capture_output=True, text=True
        ).stdout.splitlines()
        robots = []
        for serial, pose in zip(SERIALS, poses, strict=False):
            scene = scene_with_start(tmp_path / serial, pose)
            config = quick_config(
                port=0, tcp_port=0, speed=20, robot_id=int(serial), scenes=(scene,)
            )
            robots.append(stack.enter_context(SimulatorThread(config)))
        async with Master(broker.port, SERIALS[0]) as one, Master(broker.port, SERIALS[1]) as two:
            stack.enter_context(running_fleet(robots, broker, tmp_path))
            program = stack.enter_context(
                running(script, "--broker", f"127.0.0.1:{broker.port}", log=tmp_path / "master")
            )
            robots[1].set_emergency_stop(True)  # on n6, in the way of the other one
            await one.online()
            await two.online()
            await one.wait_state(lambda state: state["orderId"], "an order")
            await one.wait_state(lambda state: state["lastNodeId"] == "n5", "n5 to be reached")
            await one.wait_state(lambda state: not state["driving"])
            assert one.state["nodeStates"] == []
            robots[1].set_emergency_stop(False)
            await two.wait_state(lambda state: state["lastNodeId"] == "n8", "n8 to be reached")
            await one.wait_state(lambda state: state["lastNodeId"] == "n6", "n6 to be reached")
        program.send_signal(signal.SIGINT)
        assert await eventually(lambda: program.poll() is not None)
        assert program.returncode == 0, (tmp_path / "master").read_text()
    held: dict[str, set[str]] = {}
    for state in recorder.sent("state"):
        if state["orderId"]:
            nodes = {each["nodeId"] for each in state["nodeStates"]} | {state["lastNodeId"]}
            held[state["serialNumber"]] = nodes
            for serial, others in held.items():
                assert serial == state["serialNumber"] or not nodes & others, held
