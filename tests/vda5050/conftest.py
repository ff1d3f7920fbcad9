"""Fixtures: a broker that records and checks all messages, and a vehicle of a simulated chassis."""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import quick_config, set_speed
from tests.vda5050.broker import Mosquitto, Recorder, mosquitto_path
from tests.vda5050.master import START, Master, Message, node
from woosh_robot_agent import simulator
from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.util import task_pb2
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.simulator import Outgoing, SimulatorConfig, SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Release
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.messages.versions import V2_1
from woosh_robot_agent.vda5050.mqtt import BrokerConfig
from woosh_robot_agent.vda5050.session import VehicleConfig
from woosh_robot_agent.vda5050.vehicle import Vehicle

AT_ONCE = Limits(min_state_interval=0.0)
"""Every change is published."""
EXEC = "woosh.robot.ExecTask"
ORDER = "woosh.robot.ActionOrder"
CHARGER = (-9.5, 0.5)
"""A place in front of the charger C1."""
LEG = [node("a", 0, *START), node("b", 2, 8.0, -7.5, theta=0.0)]
"""Nodes of an order of one leg."""


def task_to(x: float, y: float) -> ExecTask:
    return ExecTask(task_id=77, type=task_pb2.kPick, pose=Pose2D(x=x, y=y, theta=0.0))


def left_by_a_kill(folder: Path) -> Path:
    """Return a copy of a state folder, as a connector that is killed at this moment leaves it."""
    copy = folder.with_name(f"{folder.name}+")
    return Path(shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("*.lock")))


def scene_with_start(folder: Path, pose: str) -> Path:
    """Make a folder with the shipped scene, in which the robot starts at a pose: x, y, theta."""
    text = (Path(simulator.__file__).parent / "data/wooshmap/scene.yaml").read_text()
    start = f"start: {{map: wooshmap, pose: [{pose}]}}"
    changed, count = re.subn(r"^start:.*", start, text, flags=re.MULTILINE)
    assert count == 1
    folder.mkdir()
    (folder / "scene.yaml").write_text(changed)
    return folder


class Held:
    """Frames of a chassis that are held back until `release`.

    Args:
        which: returns True for a frame that is held back.
    """

    def __init__(self, chassis: SimulatorThread, which: Callable[[Outgoing], bool]) -> None:
        self._chassis = chassis
        self._which = which
        self._held: list[Release] = []
        self._stop_holding = chassis.intercept(self._hold)

    def _hold(self, out: Outgoing) -> list[Outgoing]:
        if not self._which(out):
            return [out]
        return [replace(out, hold=lambda client, release: self._held.append(release))]

    async def wait(self) -> None:
        """Wait until a frame is held back."""
        await eventually(lambda: self._held)

    def release(self) -> None:
        """Send the frames held back, and stop holding back."""
        self._stop_holding()
        self._chassis.call(lambda simulator: [each() for each in self._held])


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Connectors that run as programs keep nothing from one test to the next."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state home"))


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    if mosquitto_path() is None:
        pytest.skip("mosquitto is not installed")
    with Mosquitto(tmp_path) as mosquitto:
        yield mosquitto


@pytest.fixture
def recorder(broker: Mosquitto) -> Iterator[Recorder]:
    """All messages at the broker. At the end they are checked with the published schemas."""
    with closing(Recorder(broker.port)) as recorder:
        yield recorder
    recorder.check()


@pytest.fixture
def chassis() -> Iterator[SimulatorThread]:
    """A simulated chassis that answers without delay, and drives 20 times as fast as a real one."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, speed=20)) as running:
        yield running


class Site:
    """A simulated chassis, a broker that records all messages, and vehicles that connect them."""

    def __init__(self, chassis: SimulatorThread, broker: Mosquitto, recorder: Recorder) -> None:
        self.chassis = chassis
        self.broker = broker
        self.recorder = recorder

    @asynccontextmanager
    async def vehicle(
        self,
        broker: BrokerConfig | None = None,
        request_timeout: float = LinkConfig.request_timeout,
        max_frame_size: int = LinkConfig.max_frame_size,
        **options: Any,
    ) -> AsyncIterator[None]:
        """Start a vehicle; the options are fields of `VehicleConfig`."""
        link = LinkConfig(
            ip="127.0.0.1",
            port=self.chassis.port,
            backoff_max=1.0,
            request_timeout=request_timeout,
            max_frame_size=max_frame_size,
        )
        default = replace(BrokerConfig.from_url(self.broker.url), backoff_max=1.0)
        vehicle = Vehicle(VehicleConfig(link, **options), broker or default)
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

    async def drive(
        self, master: Master, nodes: Sequence[Message] = LEG, *, then: float = 0.1
    ) -> None:
        """Send an order, wait until the robot drives, and let it drive on at another speed."""
        await master.online()
        set_speed(self.chassis, 1.0)
        master.order(nodes)
        await eventually(lambda: self.chassis.state.pose.x > START[0] + 0.2)
        set_speed(self.chassis, then)
        await master.accepted()

    def lower_battery(self) -> None:
        """Let the robot charge for some time when it is at a charger."""
        self.chassis.call(lambda simulator: setattr(simulator.chassis.battery, "level", 50.0))

    def stand_at_charger(self) -> None:
        """Put the robot, which has to charge, in front of the charger C1."""
        self.lower_battery()
        self.chassis.call(lambda simulator: simulator.chassis.localise(Pose(*CHARGER, 0.0)))

    async def idle(self) -> None:
        """Wait until the robot has no task."""
        running = (task_pb2.kInit, task_pb2.kReady, task_pb2.kExecuting, task_pb2.kActionWait)
        await eventually(lambda: self.chassis.state.info.task_proc.state not in running)

    @asynccontextmanager
    async def without_link(self, master: Master) -> AsyncIterator[None]:
        """Cut the link in a block, which begins when the state tells that the link is lost."""
        off = self.chassis.inject("off")
        await master.error("robotConnectionError")
        yield
        off.clear()

    @asynccontextmanager
    async def other_client(self) -> AsyncIterator[MotionGate]:
        """Another client of the robot, such as an agent or the vendor's app."""
        config = LinkConfig(ip="127.0.0.1", port=self.chassis.port)
        async with ChassisClient(config=config) as client:
            yield MotionGate(client)


@pytest.fixture
def lifelike(broker: Mosquitto, recorder: Recorder) -> Iterator[Site]:
    """A site whose robot reports and obeys as late as a real one, and charges on after a task."""
    config = SimulatorConfig(port=0, tcp_port=0, profile="tr200", speed=20)
    with SimulatorThread(config) as chassis:
        yield Site(chassis, broker, recorder)


@pytest.fixture
def site(chassis: SimulatorThread, broker: Mosquitto, recorder: Recorder) -> Site:
    return Site(chassis, broker, recorder)
