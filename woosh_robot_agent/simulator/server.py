"""The simulated chassis as a server: the robot, its clients, its ports, its faults, its clock."""

from __future__ import annotations

import asyncio
import logging
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_pack_pb2, robot_pb2
from woosh_robot_agent.simulator.body.base import Velocity
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults.fault import Injection
from woosh_robot_agent.simulator.faults.injector import Injector
from woosh_robot_agent.simulator.protocol.reports import robot_info
from woosh_robot_agent.simulator.serving.connections import Connections
from woosh_robot_agent.simulator.serving.exchange import Exchange, Hooks, Interceptor, Received
from woosh_robot_agent.simulator.serving.ports import Ports
from woosh_robot_agent.simulator.world.geometry import Pose


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of the robot at one moment.

    Attributes:
        elapsed: Simulated time since the start, in seconds.
        pose: Pose in the map's frame, in metres and radians.
        velocity: Velocity, in m/s and rad/s.
        odometer: Total distance driven, in metres.
        jack: Height of the lift of LiftControl, in metres.
        column: Height of the lift of LiftControl2 and LiftControl3, in metres.
        following: The robot follows a leader.
        spoken: The last texts that the robot was told to say.
        lights: Settings of the lights, by submodule.
        remote_keys: Keys of the radio remote controller that are held down, one bit each.
        info: All states as reported to clients.
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


def snapshot(chassis: Chassis) -> Snapshot:
    """Return the current state of `chassis`."""
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


_LOG = logging.getLogger(__name__)

_MIN_STEP = 0.005
"""Minimum real duration of a step within which the simulated time advances, in seconds.

At a higher speed, it advances only by whole steps.
"""

_ROUND = 0.02
"""Real duration of a round of steps at a high speed, in seconds.

Waking up costs more than a step, so each round has several steps.
"""

_END_OF_STEP = 0.999 * TIME_STEP
"""Maximum simulated time within a step, in seconds. `Chassis.tick` completes the step."""

_MAX_LAG = 10.0
"""Maximum lag of the simulation that it catches up, in seconds of real time.

The rest of a longer lag is skipped."""


class SimulatedChassis:
    """A chassis on a WebSocket and a TCP port, running in the current event loop.

    Usage:
        async with SimulatedChassis(SimulatorConfig(port=0, tcp_port=0)) as simulator:
            ...  # connect to simulator.port

    Call all methods from the thread of the event loop. `SimulatorThread` offers them to
    other threads.

    Attributes:
        config: The options.
        chassis: The model of the robot.
        speed: Simulated seconds per real second. It can be changed at any time.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        self.config = config or SimulatorConfig()
        self.chassis = Chassis(self.config)
        self.speed = self.config.speed
        self._exchange = Exchange(self.chassis, self.config.max_waiting)
        seed = random.randrange(2**32) if self.config.seed is None else self.config.seed
        steps = self.config.scenario.steps if self.config.scenario else ()
        self._injector = Injector(self, seed, steps)
        self._frozen = False
        """True if the simulated time stands still and requests are queued."""
        self._connections = Connections(
            self._exchange, self.config.max_connections, self.config.max_outbox
        )
        self._ports = Ports(self.config, self._connections.serve, self._connections.readable)
        self._ticker: asyncio.Task[None] | None = None
        self._step_start = 0.0
        """Time of the event loop that corresponds to `Chassis.stepped`, in seconds."""
        self.chassis.on_schedule = self._wake_for
        self._exchange.before_request = self._catch_up

    async def __aenter__(self) -> SimulatedChassis:
        await self.start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.stop()

    async def start(self) -> None:
        """Start listening and start the simulated clock.

        Raises:
            OSError: A port is in use.
        """
        await self.listen()
        self._connections.open()
        self._injector.advance(0.0)
        await self.settle()
        self._step_start = asyncio.get_running_loop().time()
        self._ticker = asyncio.ensure_future(self._tick())

    async def stop(self) -> None:
        """Close everything, within about a second."""
        if self._ticker:
            self._ticker.cancel()
        self._injector.clear()  # paused connections could not close
        await self.settle()
        await self._connections.close()
        await self._ports.close(reserve=False)

    async def wait_disconnected(self) -> None:
        """Wait until no client is connected."""
        await self._connections.wait_disconnected()

    async def listen(self) -> None:
        """Start listening. A second call uses the same ports as the first one.

        Raises:
            OSError: A port is in use.
        """
        await self._ports.listen()

    async def stop_listening(self) -> None:
        """Drop all clients and refuse new ones, as if the robot were switched off."""
        self.drop()
        await self._ports.close(reserve=True)

    async def settle(self) -> None:
        """Wait until the ports are open or closed as the fault `off` requires."""
        await self._ports.settle()

    @property
    def port(self) -> int:
        """WebSocket port, valid once started."""
        return self._ports.port

    @property
    def tcp_port(self) -> int:
        """TCP port, valid once started."""
        return self._ports.tcp_port

    # Faults

    @property
    def hooks(self) -> Hooks:
        """Hooks for connections, requests and outgoing frames."""
        return self._exchange.hooks

    def inject(self, name: str, /, **arguments: object) -> Injection:
        """Start a fault. `woosh_robot_agent.simulator.faults.FAULTS` lists them all.

        The fault `off` closes the ports in the background: `settle` waits for that.

        Args:
            name: Name of the fault.
            arguments: Arguments of the fault, and `for_`.

        Returns:
            The injected fault, which can be cleared.

        Raises:
            FaultError: There is no such fault, or an argument is invalid.
        """
        return self._injector.inject(name, **arguments)

    def clear_faults(self) -> None:
        """End all faults, and send at once all frames that they delay."""
        self._injector.clear()
        self._connections.release()

    @property
    def faults(self) -> list[Injection]:
        """Active faults, oldest first."""
        return self._injector.active

    @property
    def injected(self) -> Counter[str]:
        """Number of faults since the start, by name."""
        return Counter(self._injector.counts)

    # Effects of faults

    def drop(self) -> None:
        """Abort all connections, as a broken cable would."""
        self._connections.drop()

    def set_listening(self, on: bool) -> None:
        """Listen again on the same ports, or drop all clients and refuse new ones."""
        if not on:
            self.drop()
        self._ports.switch(on)

    def pause_connections(self, paused: bool) -> None:
        """Stop reading and writing without closing the connections, or continue."""
        self._connections.pause(paused)

    def freeze(self, frozen: bool) -> None:
        """Stop the simulated time and queue all requests, or continue."""
        self._frozen = frozen
        self._connections.freeze(frozen)

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.chassis.set_emergency_stop(pressed)
        self.push_changes()

    def set_key_switch(self, manual: bool, *, accept: bool = False) -> None:
        """Turn the key switch to manual, or to automatic.

        At manual, it overrides the control mode and switches the motors off.

        Args:
            manual: True for manual, False for automatic.
            accept: At manual, accept requests instead of refusing them. The motors stay off.
        """
        self.chassis.set_key_switch(manual, accept=accept)
        self.push_changes()

    def hold_remote_keys(self, keys: int, address: int = 1) -> None:
        """Hold down keys of a radio remote controller, until the next call.

        Args:
            keys: One bit for each key; 0 releases all keys.
            address: Address of the controller.
        """
        self.chassis.hold_remote_keys(keys, address)
        self.push_changes()

    def lose_localisation(self) -> None:
        """Make the robot lose its localisation."""
        self.chassis.lose_localisation()
        self.push_changes()

    def push(self, message: Message) -> None:
        """Push a message to all subscribers of its type, without changing the state."""
        self._exchange.push(message)

    def push_changes(self) -> None:
        """Push all events and changed states."""
        self._exchange.report_changes(while_moving=True)

    @property
    def backlog(self) -> int:
        """Number of frames that wait for the slowest client."""
        return self._connections.backlog

    @property
    def max_backlog(self) -> int:
        """Number of waiting frames at which a client is dropped."""
        return self.config.max_outbox

    # Observation by tests

    @property
    def connections(self) -> int:
        """Number of connected clients."""
        return self._connections.count

    @property
    def state(self) -> Snapshot:
        """Current state of the robot."""
        return snapshot(self.chassis)

    @property
    def received(self) -> list[Received]:
        """The last 10,000 messages from clients, oldest first."""
        return list(self._exchange.received)

    @property
    def counts(self) -> Counter[str]:
        """Number of messages from clients, subscriptions included, by type."""
        return Counter(self._exchange.counts)

    @property
    def bad_frames(self) -> int:
        """Number of frames that could not be decoded."""
        return self._exchange.bad_frames

    def last(self, type_name: str) -> Message | None:
        """Return the last message of a type from a client, None if there is none."""
        found = (each for each in reversed(self._exchange.received) if each.type == type_name)
        received = next(found, None)
        return received.message if received else None

    async def wait_received(
        self, type_name: str, count: int = 1, timeout: float = 60.0
    ) -> Message | None:
        """Wait until clients have sent `count` messages of a type since the start of the run.

        Returns:
            The last of them.

        Raises:
            asyncio.TimeoutError: It took longer than `timeout` seconds.
        """
        await asyncio.wait_for(self._exchange.arrived(type_name, count), timeout)
        return self.last(type_name)

    # Control by tests

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
        """End all faults that apply only to requests of a type."""
        for injection in self.faults:
            if injection.arguments.get("type") == type_name:
                injection.clear()

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Pass all outgoing frames through `interceptor`, and return a function that removes it."""
        return self.hooks.intercept(interceptor)

    def send_raw(self, data: str | bytes) -> None:
        """Send a frame to every client unchanged."""
        self._connections.send_raw(data)

    def _replace_fault(self, name: str, type_name: str, **arguments: object) -> None:
        """Start a fault for one type, and end those of the same name for this type."""
        for injection in self.faults:
            if injection.name == name and injection["type"] == type_name:
                injection.clear()
        self.inject(name, type=type_name, **arguments)

    async def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        self._step_start = loop.time()
        while True:
            duration = TIME_STEP / self.speed
            steps = 1 if self._runs_within_steps else max(1, int(_ROUND / duration))
            due = max(self._step_start + steps * duration, loop.time() - _MAX_LAG)
            self._wake_for(self.chassis.next_call)
            await asyncio.sleep(max(0.0, due - loop.time()))
            for _ in range(steps):
                self._step()
            self._step_start = due

    def _step(self) -> None:
        """Advance the simulated time by one step, and push what has changed."""
        try:
            if not self._frozen:
                self.chassis.tick(TIME_STEP)
            self._injector.advance(TIME_STEP)
            if not self._frozen:
                self.push_changes()
        except Exception:  # the clock must not stop
            _LOG.exception("cannot complete a step of the simulation")

    @property
    def _runs_within_steps(self) -> bool:
        """True if the simulated time advances within steps too."""
        return bool(self._ticker) and not self._frozen and TIME_STEP / self.speed >= _MIN_STEP

    def _wake_for(self, time: float) -> None:
        """Wake up for a call of the chassis that is due before the next step."""
        into_step = time - self.chassis.stepped
        if self._runs_within_steps and into_step < TIME_STEP:
            loop = asyncio.get_running_loop()
            loop.call_at(self._step_start + into_step / self.speed, self._catch_up)

    def _catch_up(self) -> None:
        """Advance the simulated time to this moment, within the current step."""
        if not self._runs_within_steps:
            return
        into_step = (asyncio.get_running_loop().time() - self._step_start) * self.speed
        try:
            self.chassis.run_until(self.chassis.stepped + min(into_step, _END_OF_STEP))
        except Exception:  # the clock must not stop
            _LOG.exception("a scheduled call of the simulated robot failed")
        self._wake_for(self.chassis.next_call)
