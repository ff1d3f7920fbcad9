"""Fixtures: a broker that records and checks all messages, and a vehicle of a simulated chassis."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.quick_chassis import quick_config
from tests.vda5050.broker import Mosquitto, Recorder, mosquitto_path
from tests.vda5050.master import Master
from woosh_robot_agent import simulator
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.messages.versions import V2_1
from woosh_robot_agent.vda5050.mqtt import BrokerConfig
from woosh_robot_agent.vda5050.session import VehicleConfig
from woosh_robot_agent.vda5050.vehicle import Vehicle

AT_ONCE = Limits(min_state_interval=0.0)
"""Every change is published."""
EXEC = "woosh.robot.ExecTask"


def scene_with_start(folder: Path, pose: str) -> Path:
    """Make a folder with the shipped scene, in which the robot starts at a pose: x, y, theta."""
    text = (Path(simulator.__file__).parent / "data/wooshmap/scene.yaml").read_text()
    start = f"start: {{map: wooshmap, pose: [{pose}]}}"
    changed, count = re.subn(r"^start:.*", start, text, flags=re.MULTILINE)
    assert count == 1
    folder.mkdir()
    (folder / "scene.yaml").write_text(changed)
    return folder


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Connectors that run as programs keep nothing from one test to the next."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state home"))


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    """A broker on a port of its own."""
    if mosquitto_path() is None:
        pytest.skip("mosquitto is not installed")
    mosquitto = Mosquitto(tmp_path)
    mosquitto.start()
    try:
        yield mosquitto
    finally:
        mosquitto.stop()


@pytest.fixture
def recorder(broker: Mosquitto) -> Iterator[Recorder]:
    """All messages at the broker. At the end they are checked with the published schemas."""
    recorder = Recorder(broker.port)
    try:
        yield recorder
    finally:
        recorder.stop()
    recorder.check()


@pytest.fixture
def chassis() -> Iterator[SimulatorThread]:
    """A simulated chassis that answers without delay, and drives 20 times as fast as a real one."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, speed=20)) as running:
        yield running


class Site:
    """A simulated chassis, a broker, and vehicles that connect them.

    Attributes:
        chassis: the chassis.
        broker: the broker.
        recorder: all messages at the broker.
    """

    def __init__(self, chassis: SimulatorThread, broker: Mosquitto, recorder: Recorder) -> None:
        self.chassis = chassis
        self.broker = broker
        self.recorder = recorder

    @asynccontextmanager
    async def vehicle(
        self, request_timeout: float = LinkConfig.request_timeout, **options: Any
    ) -> AsyncIterator[None]:
        """Start a vehicle; the options are fields of `VehicleConfig`."""
        link = LinkConfig(
            ip="127.0.0.1",
            port=self.chassis.port,
            backoff_max=1.0,
            request_timeout=request_timeout,
        )
        broker = replace(BrokerConfig.from_url(self.broker.url), backoff_max=1.0)
        vehicle = Vehicle(VehicleConfig(link, **options), broker)
        vehicle.start()
        try:
            yield
        finally:
            await vehicle.close()
            await asyncio.to_thread(self.recorder.catch_up)

    @asynccontextmanager
    async def online(self, **options: Any) -> AsyncIterator[Master]:
        """Start a vehicle, and return its master control when it is online."""
        version = options.get("version", V2_1).number
        async with Master(self.broker.port, version=version) as master, self.vehicle(**options):
            await master.online()
            yield master


@pytest.fixture
def site(chassis: SimulatorThread, broker: Mosquitto, recorder: Recorder) -> Site:
    """A simulated chassis and a broker."""
    return Site(chassis, broker, recorder)
