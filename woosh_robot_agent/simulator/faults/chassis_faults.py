"""Faults of the robot itself and of its pushes."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.protos import message_type
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.faults.fault import End, Fault, Injection, Target
from woosh_robot_agent.simulator.faults.parameters import FaultError, Parameter
from woosh_robot_agent.simulator.protocol.pushes import TOPICS
from woosh_robot_agent.simulator.protocol.reports import STATES

_SLICE = 100
"""Number of pushes of a burst after which clients get time to read."""

_BACKLOG_TIMEOUT = 1.0
"""Time for which a burst waits for a client that does not read, in seconds of real time."""

_POLL_PERIOD = 0.002
"""Period of checking the backlog, in seconds of real time."""


def _emergency_stop(target: Target, injection: Injection) -> End:
    before = target.chassis.readiness.emergency_stop
    target.set_emergency_stop(True)
    return lambda: target.set_emergency_stop(before)


def _lost_localisation(target: Target, injection: Injection) -> End:
    readiness = target.chassis.readiness
    before = readiness.located
    target.lose_localisation()

    def end() -> None:
        readiness.located = readiness.located or before
        target.push_changes()

    return end


def _obstacle(target: Target, injection: Injection) -> End:
    chassis = target.chassis
    x, y = injection["x"], injection["y"]
    if x is None:
        there = chassis.base.pose.moved(injection["ahead"], 0.0, 0.0)
        x, y = there.x, there.y
    name = f"fault {injection.number}"
    chassis.obstacles.put(name, x, y, injection["radius"])
    target.push_changes()

    def end() -> None:
        if name in chassis.obstacles.names:
            chassis.obstacles.remove(name)
        target.push_changes()

    return end


def _check_position(arguments: Mapping[str, Any]) -> None:
    if (arguments["x"] is None) != (arguments["y"] is None):
        raise FaultError("obstacle: give both x and y, or neither of them")


def _burst(target: Target, injection: Injection) -> End:
    pushing = asyncio.ensure_future(_push(target, injection))

    def end() -> None:
        pushing.cancel()

    return end


async def _push(target: Target, injection: Injection) -> None:
    loop = asyncio.get_running_loop()
    begun = loop.time()
    rate, count = injection["rate"], injection["count"]
    for number in range(count):
        if rate:
            await asyncio.sleep(max(0.0, begun + number / rate - loop.time()))
        elif number % _SLICE == 0:
            await _wait_for_clients(target)
        target.push(_current(target.chassis, injection["type"]))
        injection.hit()


def _current(chassis: Chassis, type_name: str) -> Message:
    """Return a current state, or an empty event."""
    cls: Any = message_type(type_name)
    return STATES[cls](chassis) if cls in STATES else cls()


async def _wait_for_clients(target: Target) -> None:
    """Wait until clients have read enough, or until a timeout."""
    loop = asyncio.get_running_loop()
    until = loop.time() + _BACKLOG_TIMEOUT
    await asyncio.sleep(0)
    while target.backlog > target.max_backlog // 2 and loop.time() < until:
        await asyncio.sleep(_POLL_PERIOD)


def _check_topic(arguments: Mapping[str, Any]) -> None:
    if arguments["type"] not in TOPICS:
        raise FaultError(f"burst: type: {arguments['type']!r} is not one of {sorted(TOPICS)}")


FAULTS = (
    Fault(
        "emergency_stop",
        "the emergency stop button is pressed; at the end it is released",
        _emergency_stop,
        shared=True,
    ),
    Fault(
        "lost_localisation",
        "the robot does not know its pose, until a client sends the pose or the fault ends",
        _lost_localisation,
        shared=True,
    ),
    Fault(
        "obstacle",
        "a round obstacle appears; at the end it disappears",
        _obstacle,
        (
            Parameter("x", float, None, "position in the map's frame", unit="m"),
            Parameter("y", float, None, "position in the map's frame", unit="m"),
            Parameter(
                "ahead",
                float,
                1.0,
                "without x and y: distance in front of the current position of the robot",
                unit="m",
            ),
            Parameter(
                "radius", float, 0.3, "radius of the obstacle", unit="m", low=0.01, high=100.0
            ),
        ),
        check=_check_position,
    ),
    Fault(
        "burst",
        "many pushes are sent to all subscribers of their type",
        _burst,
        (
            Parameter("count", int, 1000, "number of pushes", low=1, high=10_000_000),
            Parameter("type", str, "woosh.robot.PoseSpeed", "type of the pushes", is_message=True),
            Parameter(
                "rate",
                float,
                0.0,
                "rate of the pushes; 0: as fast as clients read",
                unit="1/s of real time",
                low=0.0,
            ),
        ),
        lasting=False,
        check=_check_topic,
    ),
)
