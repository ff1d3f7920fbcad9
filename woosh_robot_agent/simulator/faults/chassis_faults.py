"""Faults of the robot itself, and of what it reports."""

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

#: Pushes of a burst that are sent before clients get time to read.
_SLICE = 100
#: Real s for which a burst waits for a client that does not read.
_PATIENCE_S = 1.0
_PAUSE_S = 0.002


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
        target.report()

    return end


def _obstacle(target: Target, injection: Injection) -> End:
    chassis = target.chassis
    x, y = injection["x"], injection["y"]
    if x is None:
        there = chassis.base.pose.moved(injection["ahead"], 0.0, 0.0)
        x, y = there.x, there.y
    name = f"fault {injection.number}"
    chassis.obstacles.put(name, x, y, injection["radius"])
    target.report()

    def end() -> None:
        if name in chassis.obstacles.names:
            chassis.obstacles.remove(name)
        target.report()

    return end


def _whole_place(arguments: Mapping[str, Any]) -> None:
    if (arguments["x"] is None) != (arguments["y"] is None):
        raise FaultError("obstacle: x and y go together; without them it is put `ahead`")


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
            await _room(target)
        target.push(_current(target.chassis, injection["type"]))
        injection.hit()


def _current(chassis: Chassis, type_name: str) -> Message:
    """A state as it is, or an empty event."""
    cls: Any = message_type(type_name)
    return STATES[cls](chassis) if cls in STATES else cls()


async def _room(target: Target) -> None:
    """Give clients time to read; one that does not read at all holds up nobody for long."""
    loop = asyncio.get_running_loop()
    until = loop.time() + _PATIENCE_S
    await asyncio.sleep(0)
    while target.backlog() > target.room() // 2 and loop.time() < until:
        await asyncio.sleep(_PAUSE_S)


def _topic(arguments: Mapping[str, Any]) -> None:
    if arguments["type"] not in TOPICS:
        raise FaultError(f"burst: type: {arguments['type']!r} is not one of {sorted(TOPICS)}")


FAULTS = (
    Fault(
        "emergency_stop",
        "the button is pressed; at the end it is released",
        _emergency_stop,
        shared=True,
    ),
    Fault(
        "lost_localisation",
        "the robot does not know where it is, until a client localises it or the fault ends",
        _lost_localisation,
        shared=True,
    ),
    Fault(
        "obstacle",
        "something round stands in the way; at the end it is gone",
        _obstacle,
        (
            Parameter("x", float, None, "where, in the map's frame", unit="m"),
            Parameter("y", float, None, "where, in the map's frame", unit="m"),
            Parameter(
                "ahead",
                float,
                1.0,
                "without x and y: how far in front of the base's centre as it stands now",
                unit="m",
            ),
            Parameter("radius", float, 0.3, "how big", unit="m", low=0.01, high=100.0),
        ),
        check=_whole_place,
    ),
    Fault(
        "burst",
        "many pushes to everybody who subscribed to their type; over when all are sent",
        _burst,
        (
            Parameter("count", int, 1000, "how many", low=1, high=10_000_000),
            Parameter("type", str, "woosh.robot.PoseSpeed", "what is pushed", is_message=True),
            Parameter(
                "rate", float, 0.0, "0: as fast as clients read", unit="1/s of real time", low=0.0
            ),
        ),
        lasting=False,
        check=_topic,
    ),
)
