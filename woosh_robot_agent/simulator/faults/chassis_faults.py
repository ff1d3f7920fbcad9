"""Faults of the robot itself and of its pushes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.simulator import status_codes
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.config import MAX_CLOCK_OFFSET
from woosh_robot_agent.simulator.faults.fault import Argument, End, FaultError, Injection, fault
from woosh_robot_agent.simulator.protocol.reports import PERIODIC, STATES, TOPICS
from woosh_robot_agent.simulator.serving.server import Server

_SLICE = 100
"""Number of pushes of a burst without a `rate` after which clients get time to read."""

_BURST_CODES = (
    status_codes.OBSTACLE_IN_THE_WAY,
    status_codes.DRIVING_STRAIGHT,
    status_codes.TURNING_LEFT,
    status_codes.TURNING_RIGHT,
)
"""Codes of a burst of status codes."""

_REPEATED_SHARE = 0.8
"""Probability that a code of a burst repeats the one before, instead of being chosen anew."""

_BACKLOG_TIMEOUT = 1.0
"""Maximum time for which a burst waits for clients to read, in seconds of real time."""

_MAX_UINT32 = 2**32 - 1

_POLL_PERIOD = 0.002
"""Period of checking whether clients have read, in seconds of real time."""


@fault("the emergency stop button is pressed; at the end it is released", shared=True)
def _emergency_stop(server: Server, injection: Injection) -> End:
    was_pressed = server.chassis.readiness.emergency_stop
    server.set_emergency_stop(True)
    return lambda: server.set_emergency_stop(was_pressed)


@fault(
    "the robot does not know its pose, until a client sends the pose or the fault ends", shared=True
)
def _lost_localisation(server: Server, injection: Injection) -> End:
    readiness = server.chassis.readiness
    was_located = readiness.located
    server.lose_localisation()

    def end() -> None:
        readiness.located = readiness.located or was_located
        server.push_changes()

    return end


@fault(
    "the key switch is at manual: the motors are off; at the end it is back where it was",
    Argument(
        "requests",
        "refused",
        "requests that move the robot are refused, or accepted although nothing moves",
        choices=("refused", "accepted"),
    ),
    shared=True,
)
def _key_switch(server: Server, injection: Injection) -> End:
    readiness = server.chassis.readiness
    was_manual, accepted = readiness.key_manual, readiness.key_accepts
    server.set_key_switch(True, accept=injection["requests"] == "accepted")
    return lambda: server.set_key_switch(was_manual, accept=accepted)


@fault(
    "keys of a radio remote controller are held down; at the end they are released",
    Argument("keys", 1, "one bit for each key", 1, _MAX_UINT32),
    Argument("address", 1, "address of the controller", 0, _MAX_UINT32),
)
def _remote_keys(server: Server, injection: Injection) -> End:
    keys, address = injection["keys"], injection["address"]
    server.hold_remote_keys(keys, address)
    return lambda: server.hold_remote_keys(0, address)


@fault(
    "the clock of the robot jumps; at the end it jumps back",
    Argument(
        "by",
        3600.0,
        "size of the jump, negative for a jump back",
        -MAX_CLOCK_OFFSET,
        MAX_CLOCK_OFFSET,
        unit="s",
    ),
)
def _clock_jump(server: Server, injection: Injection) -> End:
    chassis = server.chassis
    before = chassis.clock_offset
    chassis.clock_offset = min(MAX_CLOCK_OFFSET, max(-MAX_CLOCK_OFFSET, before + injection["by"]))
    jump = chassis.clock_offset - before

    def end() -> None:
        chassis.clock_offset -= jump

    return end


# Texts with keys, which a page can show in another language.
_HALF_POSITION = Sentence("obstacle: give both x and y, or neither of them")
_NO_TOPIC = Sentence("burst: type: {type} is not one of {topics}")


def _check_position(arguments: Mapping[str, Any]) -> None:
    if (arguments["x"] is None) != (arguments["y"] is None):
        raise FaultError(_HALF_POSITION())


@fault(
    "a round obstacle appears; at the end it disappears",
    Argument("x", None, "position in the map's frame", unit="m"),
    Argument("y", None, "position in the map's frame", unit="m"),
    Argument(
        "ahead",
        1.0,
        "without x and y: distance in front of the current position of the robot",
        unit="m",
    ),
    Argument("radius", 0.3, "radius of the obstacle", 0.01, 100, unit="m"),
    check=_check_position,
)
def _obstacle(server: Server, injection: Injection) -> End:
    chassis = server.chassis
    x, y = injection["x"], injection["y"]
    if x is None:
        there = chassis.base.pose.moved(injection["ahead"], 0.0, 0.0)
        x, y = there.x, there.y
    name = f"fault {injection.number}"
    chassis.obstacles.put(name, x, y, injection["radius"])
    server.push_changes()

    def end() -> None:
        if name in chassis.obstacles.names:  # a test may have removed it
            chassis.obstacles.remove(name)
        server.push_changes()

    return end


def _check_topic(arguments: Mapping[str, Any]) -> None:
    if arguments["type"] not in TOPICS:
        raise FaultError(_NO_TOPIC(type=repr(arguments["type"]), topics=str(sorted(TOPICS))))


@fault(
    "many pushes are sent to all subscribers of their type",
    Argument("count", 1000, "number of pushes", 1, 10_000_000),
    Argument("type", "woosh.robot.PoseSpeed", "type of the pushes", is_message=True),
    Argument(
        "rate", 0.0, "rate of the pushes; 0: as fast as clients read", 0, unit="1/s of real time"
    ),
    lasting=False,
    check=_check_topic,
)
def _burst(server: Server, injection: Injection) -> End:
    def push() -> None:
        server.push(_current(server.chassis, injection["type"]))

    return asyncio.ensure_future(_repeat(server, injection, push)).cancel


@fault(
    "many status codes are sent, the same ones again and again",
    Argument("count", 300, "number of status codes", 1, 10_000_000),
    Argument(
        "rate",
        300.0,
        "rate of the status codes; 0: as fast as clients read",
        0,
        unit="1/s of real time",
    ),
    lasting=False,
)
def _code_burst(server: Server, injection: Injection) -> End:
    rng = injection.rng
    code = rng.choice(_BURST_CODES)

    def report() -> None:
        nonlocal code
        if rng.random() > _REPEATED_SHARE:
            code = rng.choice(_BURST_CODES)
        server.chassis.codes.report(code, util_action_pb2.kNav)
        server.push_changes()

    return asyncio.ensure_future(_repeat(server, injection, report)).cancel


async def _repeat(server: Server, injection: Injection, push: Callable[[], None]) -> None:
    """Call `push` `count` times, at the `rate`, or as fast as clients read if that is 0."""
    loop = asyncio.get_running_loop()
    start = loop.time()
    rate, count = injection["rate"], injection["count"]
    for number in range(count):
        if rate:
            await asyncio.sleep(max(0.0, start + number / rate - loop.time()))
        elif number % _SLICE == 0:
            await _wait_for_clients(server)
        push()
        injection.hit()  # the last one ends the fault, because it reaches `count`


def _current(chassis: Chassis, type_name: str) -> Message:
    """Return the report of this type on the current state; for an event, an empty message."""
    cls: Any = message_type(type_name)
    report = STATES.get(cls) or PERIODIC.get(cls)
    return report(chassis) if report else cls()


async def _wait_for_clients(server: Server) -> None:
    """Wait while more than half of `max_outbox` frames wait for a client, until a timeout."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + _BACKLOG_TIMEOUT
    await asyncio.sleep(0)  # let the connections send even if few frames wait
    while server.backlog > server.config.max_outbox // 2 and loop.time() < deadline:
        await asyncio.sleep(_POLL_PERIOD)
