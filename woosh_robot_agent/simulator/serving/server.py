"""The robot with its clients, its ports and its clock, on which faults act."""

from __future__ import annotations

import asyncio
import logging

from google.protobuf.message import Message

from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.serving.connections import Connections, Ports
from woosh_robot_agent.simulator.serving.exchange import Hooks, MessageHandler

_LOG = logging.getLogger(__name__)

_MIN_STEP = 0.005
"""Minimum real duration of a step within which the simulated time advances too, in seconds.

At a higher speed, steps are shorter, and the time advances by whole steps.
"""

_ROUND_DURATION = 0.02
"""Real duration of a round of steps at a high speed, in seconds.

Waking up costs more than a step, so each round has several steps.
"""

_END_OF_STEP = 0.999 * TIME_STEP
"""Maximum simulated time within a step, in seconds. `Chassis.tick` completes the step."""

_MAX_LAG = 10.0
"""Maximum lag of the simulation that is caught up, in seconds of real time. The rest is skipped."""


class Server:
    """A robot on a WebSocket and a TCP port, running in the current event loop.

    Args:
        config: the options; None for the defaults.

    Attributes:
        chassis: the model of the robot.
        speed: simulated seconds per real second, above 0. It can be changed at any time.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        self.config = config or SimulatorConfig()
        self.chassis = Chassis(self.config)
        self.speed = self.config.speed
        self._handler = MessageHandler(self.chassis, self.config.max_waiting)
        self._connections = Connections(self._handler, self.config)
        self._ports = Ports(self.config, self._connections)
        self._ticker: asyncio.Task[None] | None = None
        """Task that advances the simulated time, None before the start."""
        self._step_start = 0.0
        """Time of the event loop at which the current simulation step began, in seconds."""
        self.chassis.on_schedule = self._wake_for
        self._handler.before_request = self._catch_up

    @property
    def port(self) -> int:
        """Port of WebSocket and HTTP. If any free port may be used, it is valid once started."""
        return self._ports.port

    @property
    def tcp_port(self) -> int:
        """TCP port. If any free port may be used, it is valid once started."""
        return self._ports.tcp_port

    @property
    def connections(self) -> int:
        """Number of connected clients."""
        return self._connections.count

    @property
    def hooks(self) -> Hooks:
        """Hooks for connections, requests and outgoing frames."""
        return self._handler.hooks

    async def listen(self) -> None:
        """Start listening. A second call uses the same ports as the first one.

        Raises:
            OSError: a port is in use.
        """
        await self._ports.listen()

    async def stop_listening(self) -> None:
        """Drop all clients and refuse new ones, as if the robot were switched off."""
        self.drop()
        await self._ports.close(reserve=True)

    async def settle(self) -> None:
        """Wait until the last `set_listening` has taken effect, which the fault `off` calls."""
        await self._ports.settle()

    def drop(self) -> None:
        """Abort all connections, as a broken cable would."""
        self._connections.drop()
        self._ports.drop()

    def set_listening(self, on: bool) -> None:
        """Listen again on the same ports, or drop all clients and refuse new ones."""
        if not on:
            self.drop()
        self._ports.set_listening(on)

    def pause_connections(self, paused: bool) -> None:
        """Stop reading and writing without closing the connections (True), or continue (False)."""
        self._connections.set_paused(paused)

    def freeze(self, frozen: bool) -> None:
        """Stop the simulated time, queue all requests and send nothing (True), or continue."""
        self._connections.set_frozen(frozen)

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.chassis.set_emergency_stop(pressed)
        self.push_changes()

    def set_key_switch(self, manual: bool, *, accept: bool = False) -> None:
        """Turn the key switch to manual, which overrides the control mode, or to automatic (False).

        At manual the motors are off; with `accept`, requests are accepted although nothing moves.
        """
        self.chassis.set_key_switch(manual, accept=accept)
        self.push_changes()

    def hold_remote_keys(self, keys: int, address: int = 1) -> None:
        """Hold down keys of a radio remote controller: one bit each, 0 to release all."""
        self.chassis.hold_remote_keys(keys, address)
        self.push_changes()

    def lose_localisation(self) -> None:
        """Make the robot lose its localisation."""
        self.chassis.lose_localisation()
        self.push_changes()

    def push(self, message: Message) -> None:
        """Push a message to all subscribers of its type, without changing the state."""
        self._handler.push(message)

    def push_changes(self) -> None:
        """Push all events and changed states to their subscribers."""
        self._handler.report_changes(while_moving=True)

    @property
    def backlog(self) -> int:
        """Largest number of frames that wait for one client."""
        return self._connections.backlog

    def start_clock(self) -> None:
        """Start the simulated time, and begin to read and send frames."""
        self._connections.open()
        self._step_start = asyncio.get_running_loop().time()
        self._ticker = asyncio.ensure_future(self._tick())

    def stop_clock(self) -> None:
        """Stop the simulated time."""
        if self._ticker:
            self._ticker.cancel()

    def on_step(self) -> None:
        """Called in each step, also while the robot is frozen; subclasses may override it."""

    async def _tick(self) -> None:
        """Advance the simulated time step by step, as fast as `speed` says."""
        loop = asyncio.get_running_loop()
        self._step_start = loop.time()
        while True:
            duration = TIME_STEP / self.speed
            steps = 1 if self._runs_within_steps else max(1, int(_ROUND_DURATION / duration))
            due = max(self._step_start + steps * duration, loop.time() - _MAX_LAG)
            self._wake_for(self.chassis.next_call)
            await asyncio.sleep(max(0.0, due - loop.time()))
            for _ in range(steps):
                self._step()
            self._step_start = due

    def _step(self) -> None:
        """Advance the simulated time by one step, and push what has changed.

        While the robot is frozen, only call `on_step`.
        """
        try:
            if not self._handler.frozen:
                self.chassis.tick(TIME_STEP)
            self.on_step()
            if not self._handler.frozen:
                self.push_changes()
        except Exception:  # the clock must not stop
            _LOG.exception("cannot complete a step of the simulation")

    @property
    def _runs_within_steps(self) -> bool:
        """True if the simulated time advances between two steps too."""
        return (
            bool(self._ticker) and not self._handler.frozen and TIME_STEP / self.speed >= _MIN_STEP
        )

    def _wake_for(self, time: float) -> None:
        """Wake up at the simulated `time` for a call of the chassis, if it is in this step."""
        into_step = time - self.chassis.stepped
        if self._runs_within_steps and into_step < TIME_STEP:
            loop = asyncio.get_running_loop()
            loop.call_at(self._step_start + into_step / self.speed, self._catch_up)

    def _catch_up(self) -> None:
        """Advance the simulated time to this moment, but not beyond the current step."""
        if not self._runs_within_steps:
            return
        into_step = (asyncio.get_running_loop().time() - self._step_start) * self.speed
        try:
            self.chassis.run_until(self.chassis.stepped + min(into_step, _END_OF_STEP))
        except Exception:  # the clock must not stop
            _LOG.exception("a scheduled call of the simulated robot failed")
        self._wake_for(self.chassis.next_call)
