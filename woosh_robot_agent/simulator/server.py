"""The simulated chassis: the robot with its clients and faults, and its state for tests."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_pack_pb2, robot_pb2
from woosh_robot_agent.simulator.body.base import Velocity
from woosh_robot_agent.simulator.chassis import TIME_STEP
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults.fault import Injection, Injector
from woosh_robot_agent.simulator.protocol.reports import robot_info
from woosh_robot_agent.simulator.serving.exchange import Interceptor, Received, add_hook
from woosh_robot_agent.simulator.serving.server import Server
from woosh_robot_agent.simulator.world.geometry import Pose


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of the robot at one moment.

    Attributes:
        elapsed: simulated time since the start, in seconds.
        pose: pose in the map's frame, in metres and radians.
        velocity: velocity in the robot's frame, in m/s and rad/s.
        odometer: total distance driven, in metres.
        jack: height of the lift of LiftControl, in metres.
        column: height of the lift of LiftControl2 and LiftControl3, in metres.
        following: True if the robot follows a leader.
        spoken: the last texts that the robot was told to say, oldest first.
        lights: last request for each submodule of the lights.
        remote_keys: keys of the radio remote controller that are held down, one bit each.
        info: all states as reported to clients.
    """

    elapsed: float
    pose: Pose
    velocity: Velocity
    odometer: float
    jack: float
    column: float
    following: bool
    spoken: tuple[str, ...]
    lights: dict[int, robot_pack_pb2.LED]
    remote_keys: int
    info: robot_pb2.RobotInfo


class SimulatedChassis(Server):
    """A chassis on a WebSocket and a TCP port, running in the current event loop.

    Usage:
        async with SimulatedChassis(SimulatorConfig(port=0, tcp_port=0)) as simulator:
            ...  # connect to simulator.port

    Call all methods from the thread of the event loop. `SimulatorThread` offers them to
    other threads.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        super().__init__(config)
        seed = random.randrange(2**32) if self.config.seed is None else self.config.seed
        self._injector = Injector(self, seed, self.config.scenario.steps)

    async def __aenter__(self) -> SimulatedChassis:
        await self.start()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.stop()

    async def start(self) -> None:
        """Start listening and start the simulated clock.

        Raises:
            OSError: a port is in use.
        """
        await self.listen()
        self._injector.advance(0.0)  # begins the faults that are due at the start
        await self.settle()
        self.start_clock()

    async def stop(self) -> None:
        """Close all connections, and the ports."""
        self.stop_clock()
        self._injector.clear()  # otherwise, paused connections could not close
        await self.settle()
        await self._close_connections()
        await self._close(reserve=False)

    def on_step(self) -> None:
        self._injector.advance(TIME_STEP)

    def inject(self, name: str, /, **arguments: object) -> Injection:
        """Start a fault. `woosh_robot_agent.simulator.faults.FAULTS` lists them all.

        The fault `off` closes the ports in the background: `settle` waits for that.

        Args:
            arguments: arguments of the fault, and `for_`, the simulated seconds until it ends.

        Returns:
            The injected fault, which can be cleared.

        Raises:
            FaultError: there is no such fault, or an argument is invalid.
        """
        return self._injector.inject(name, **arguments)

    def clear_faults(self) -> None:
        """End all faults, and send at once all frames that they delay."""
        self._injector.clear()
        for client in list(self._handler.clients):
            client.send_delayed()

    @property
    def faults(self) -> list[Injection]:
        """Active faults, oldest first."""
        return self._injector.active

    @property
    def injected(self) -> Counter[str]:
        """Number of faults that have begun since the start, by name."""
        return Counter(self._injector.counts)

    @property
    def state(self) -> Snapshot:
        """Current state of the robot."""
        chassis = self.chassis
        return Snapshot(
            elapsed=chassis.elapsed,
            pose=chassis.pose,
            velocity=chassis.base.velocity,
            odometer=chassis.base.odometer,
            jack=chassis.jack.height,
            column=chassis.column.height,
            following=chassis.follower.active,
            spoken=tuple(chassis.spoken),
            lights=dict(chassis.lights),
            remote_keys=chassis.remote_controller.keys,
            info=robot_info(chassis),
        )

    @property
    def received(self) -> list[Received]:
        """The last messages from clients, oldest first: at most 10,000 and 64 MiB."""
        return list(self._handler.received)

    @property
    def counts(self) -> Counter[str]:
        """Number of readable messages from clients since the start, by type."""
        return Counter(self._handler.counts)

    @property
    def bad_frames(self) -> int:
        """Number of frames from clients that could not be decoded."""
        return self._handler.bad_frames

    def last(self, type_name: str) -> Message | None:
        """Return the last message of a type in `received`, None if there is none."""
        for received in reversed(self._handler.received):
            if received.type == type_name:
                return received.message
        return None

    async def wait_received(
        self, type_name: str, count: int = 1, timeout: float = 60.0
    ) -> Message | None:
        """Wait until clients have sent `count` messages of a type since the start.

        Returns:
            The last message of the type; None if it is no longer in `received`.

        Raises:
            asyncio.TimeoutError: they have not arrived within `timeout` seconds.
        """
        await asyncio.wait_for(self._handler.wait_received(type_name, count), timeout)
        return self.last(type_name)

    def refuse(self, type_name: str, text: str) -> None:
        """Refuse all requests of a type with `text`, without executing them."""
        self._replace_fault("refuse", type_name, text=text)

    def delay(self, type_name: str, seconds: float) -> None:
        """Delay all answers to requests of a type by `seconds` of real time."""
        self._replace_fault("delay", type_name, seconds=seconds)

    def mute(self, type_name: str) -> None:
        """Execute requests of a type without answering them."""
        self._replace_fault("lose_answer", type_name)

    def answer_as(self, type_name: str, other: str) -> None:
        """Answer all requests of a type with the wrong message type `other`."""
        self._replace_fault("wrong_type", type_name, other=other)

    def accept(self, type_name: str) -> None:
        """End all faults that apply only to requests of this type."""
        for injection in self.faults:
            if injection.arguments.get("type") == type_name:
                injection.clear()

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Pass all outgoing frames through `interceptor`, and return a function that removes it."""
        return add_hook(self.hooks.interceptors, interceptor)

    def _replace_fault(self, name: str, type_name: str, **arguments: object) -> None:
        """Start a fault for a request type, and end faults of the same name for this type."""
        for injection in self.faults:
            if injection.name == name and injection["type"] == type_name:
                injection.clear()
        self.inject(name, type=type_name, **arguments)
