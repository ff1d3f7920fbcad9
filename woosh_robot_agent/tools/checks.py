"""What the doctor checks, in order. Nothing here commands the robot: it asks for RobotInfo once."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.codecs.choice import client_codec
from woosh_robot_agent.link.codecs.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.link.transport.base import Transport, TransportClosedError
from woosh_robot_agent.link.transport.opening import open_transport
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.readiness import (
    DEPLOYMENT,
    EMERGENCY_STOP,
    LOST,
    MAINTENANCE,
    MANUAL,
    NO_CONTROL_MODE,
    NO_WORK_MODE,
    NOT_INITIALISED,
    SCHEDULE,
    Objection,
    is_located,
    is_taskable,
    objections,
)
from woosh_robot_agent.tools.words import word

CHECKS = (
    "network",
    "port",
    "handshake",
    "RobotInfo",
    "mode",
    "initialisation",
    "localisation",
    "emergency stop",
    "taskable",
    "clock",
)
_MODES = (MANUAL, MAINTENANCE, NO_CONTROL_MODE, DEPLOYMENT, SCHEDULE, NO_WORK_MODE)
_SILENT = "read the robot's own screen; its firmware may be too old to say"
NOT_REACHED = "not checked, because of the above"
"""Text of the checks that come after one without which they make no sense."""
_SN = 1


class Status(Enum):
    """How a check ended."""

    OK = "ok"
    WARN = "warn"
    FAIL = "FAIL"
    SKIPPED = "skip"


@dataclass(frozen=True)
class Result:
    """How one check ended.

    Attributes:
        status: how.
        text: what was found.
        remedy: what to do about it; empty where nothing is to be done.
        check: its name, one of `CHECKS`.
    """

    status: Status
    text: str
    remedy: str = ""
    check: str = ""


class _Failed(Exception):
    """Ends the examination: what comes later makes no sense."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.result = Result(Status.FAIL, text, remedy)


class _Told(NamedTuple):
    """What the robot answered.

    Attributes:
        info: the answer.
        skew: s by which its clock is ahead of ours; None where the answer carries no time.
        round_trip: s that the answer took.
    """

    info: RobotInfo
    skew: float | None
    round_trip: float


async def examine(config: LinkConfig, max_skew: float) -> AsyncIterator[Result]:
    """Check one robot; a result for each of `CHECKS`, each as soon as it is there.

    Args:
        config: how to reach the robot.
        max_skew: s by which the clocks may differ.
    """
    names = iter(CHECKS)
    try:
        async for result in _checks(config, max_skew):
            yield replace(result, check=next(names))
    except _Failed as error:
        yield replace(error.result, check=next(names))
    for name in names:
        yield Result(Status.SKIPPED, NOT_REACHED, check=name)


async def _checks(config: LinkConfig, max_skew: float) -> AsyncIterator[Result]:
    address, refused = await _knock_at_all(config, await _resolve(config))
    yield Result(Status.OK, f"{address[0]} answers, reached from {_own_address(address)}")
    if refused is not None:
        raise _Failed(
            f"port {config.effective_port} is closed ({refused})",
            "check --port and --transport; if they are right, the robot's program does not run: "
            "wait until it has started, or switch the robot off and on",
        )
    yield Result(Status.OK, f"{config.effective_port} is open")
    transport = await _open(config)
    try:
        over_tcp = config.transport == "tcp"
        yield Result(Status.OK, "tcp needs none" if over_tcp else "it is a WebSocket")
        told = await _ask(transport, config)
    finally:
        await transport.close(config.close_timeout)
    yield _who(told)
    for judge in (_mode, _initialisation, _localisation, _emergency_stop, _taskable):
        yield judge(told.info)
    yield _clock(told, max_skew)


# The way to the robot


async def _resolve(config: LinkConfig) -> list[tuple[str, int]]:
    loop = asyncio.get_running_loop()
    asking = loop.getaddrinfo(config.ip, config.effective_port, type=socket.SOCK_STREAM)
    try:
        found = await run_with_timeout(config.connect_timeout, asking)
    except (TimeoutError, OSError, UnicodeError) as error:
        raise _Failed(
            f"no address is known of {config.ip} ({error})",
            "check the spelling, or give --ip the robot's address in numbers",
        ) from None
    return [(str(address[0]), int(address[1])) for *_, address in found]


async def _knock_at_all(
    config: LinkConfig, addresses: list[tuple[str, int]]
) -> tuple[tuple[str, int], str | None]:
    """The address that takes us, else one that is there, and why its port is closed.

    A name can have several addresses, of which the robot need not use the first.
    """
    closed: tuple[tuple[str, int], str | None] | None = None
    failed: _Failed | None = None
    for address in addresses:
        try:
            refused = await _knock(config, address)
        except _Failed as error:
            failed = error
            continue
        if refused is None:
            return address, None
        closed = address, refused
    if closed is None:
        assert failed is not None
        raise failed
    return closed


async def _knock(config: LinkConfig, address: tuple[str, int]) -> str | None:
    """Connect and go; why the port is closed, or None."""
    try:
        opening = asyncio.open_connection(*address)
        _, writer = await run_with_timeout(config.connect_timeout, opening)
    except ConnectionError as error:  # the other end said so: it is there
        return _plain(error)
    except TimeoutError:
        raise _Failed(
            f"{address[0]} does not answer within {config.connect_timeout:g} s",
            "check that the robot is on and in this network, that --ip is right, and that no "
            f"firewall holds back port {config.effective_port}",
        ) from None
    except OSError as error:
        routes = error.errno in (errno.ENETUNREACH, errno.EADDRNOTAVAIL)
        raise _Failed(
            f"{address[0]} cannot be reached ({_plain(error)})",
            "connect this computer to the robot's network, with an address in the same subnet"
            if routes
            else "check that the robot is on and in this network, and that --ip is right",
        ) from None
    writer.transport.abort()
    return None


def _plain(error: OSError) -> str:
    """The system's words for it, without asyncio's."""
    return os.strerror(error.errno) if error.errno else str(error) or type(error).__name__


def _own_address(address: tuple[str, int]) -> str:
    """The address of ours from which the robot is reached; nothing is sent."""
    family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)
        return str(probe.getsockname()[0])


async def _open(config: LinkConfig) -> Transport:
    try:
        return await open_transport(config)
    except TransportClosedError as error:
        raise _Failed(
            f"what listens there is no chassis: {error}",
            "check --port and --transport; a proxy or another program may have that port",
        ) from None
    except TimeoutError:
        raise _Failed(
            f"it accepts the connection, but says nothing within {config.connect_timeout:g} s",
            "the robot's program hangs or another one has that port: check --port and --transport, "
            "else switch the robot off and on",
        ) from None
    except OSError as error:
        raise _Failed(
            f"the connection broke ({_plain(error)})",
            "try again; if it stays, the network or the robot's program is unsteady",
        ) from None


# The question


async def _ask(transport: Transport, config: LinkConfig) -> _Told:
    codec = client_codec(config)
    bad: list[FrameError] = []
    started = time.time()
    try:
        await transport.send(
            codec.encode(
                full_name(RobotInfo),
                RobotInfo(robot_id=config.robot_id or None),
                sn=_SN,
                timestamp=round(started * 1000),
            )
        )
        answer = await run_with_timeout(config.handshake_timeout, _answer(transport, codec, bad))
    except TransportClosedError as error:
        raise _Failed(
            f"it hung up when asked ({error})",
            "check --encoding; else its program is in trouble: switch the robot off and on",
        ) from None
    except TimeoutError:
        raise _Failed(
            f"no answer within {config.handshake_timeout:g} s"
            + (f", only frames that cannot be read ({bad[-1]})" if bad else ""),
            "check --encoding and --robot-id; if they are right, the robot's program hangs: switch "
            "the robot off and on",
        ) from None
    ended = time.time()
    info = _info(codec, answer)
    skew = None if not answer.timestamp else answer.timestamp / 1000 - (started + ended) / 2
    return _Told(info, skew, ended - started)


async def _answer(transport: Transport, codec: Codec, bad: list[FrameError]) -> Envelope:
    while True:
        try:
            envelope = codec.decode(await transport.recv())
        except FrameError as error:
            bad.append(error)
        else:
            if envelope.sn == _SN:
                return envelope


def _info(codec: Codec, answer: Envelope) -> RobotInfo:
    if not answer.ok:
        raise _Failed(
            f"refused: {answer.msg or 'without a reason'}", "check --robot-id, and do what it says"
        )
    if answer.type != full_name(RobotInfo):
        raise _Failed(
            f"it answers with {answer.type or 'nothing'} instead",
            "this is another kind of machine, or its firmware is not supported",
        )
    try:
        return codec.body(answer, RobotInfo)
    except FrameError as error:
        raise _Failed(
            f"the answer cannot be read: {error}",
            "its firmware may be newer than this package: record it with `record` and report it",
        ) from None


# The answer


def _who(told: _Told) -> Result:
    general = told.info.genral
    about = [
        f"robot {told.info.robot_id or general.serial_number}",
        general.display_model,
        f"software {general.version.rc}" if general.version.rc else "",
        f"answered in {told.round_trip * 1000:.0f} ms",
    ]
    return Result(Status.OK, ", ".join(part for part in about if part))


def _joined(found: list[Objection]) -> Result:
    reasons = "; ".join(objection.reason for objection in found)
    remedies = "; ".join(dict.fromkeys(objection.remedy for objection in found))
    return Result(Status.FAIL, reasons, remedies)


def _mode(info: RobotInfo) -> Result:
    if not info.HasField("mode"):
        return Result(Status.WARN, "the robot does not say it", _SILENT)
    if found := [objection for objection in objections(info) if objection in _MODES]:
        return _joined(found)
    ctrl, work = word(robot.ControlMode, info.mode.ctrl), word(robot.WorkMode, info.mode.work)
    return Result(Status.OK, f"control {ctrl}, work {work}")


def _initialisation(info: RobotInfo) -> Result:
    if NOT_INITIALISED in objections(info):
        return _joined([NOT_INITIALISED])
    state = word(robot.State, info.state)
    if info.state == robot.kStateUndefined:
        return Result(Status.WARN, "the robot does not say its state", _SILENT)
    if info.state == robot.kFault:
        return Result(Status.SKIPPED, "a fault hides it: look again when that is over")
    return Result(Status.OK, f"state {state}")


def _localisation(info: RobotInfo) -> Result:
    if info.state == robot.kUninit:
        return Result(Status.SKIPPED, "comes with the initialisation")
    return _flag(is_located(info), LOST, "it knows where it is")


def _emergency_stop(info: RobotInfo) -> Result:
    pressed = EMERGENCY_STOP in objections(info)
    known = info.HasField("device_state")
    return _flag(not pressed if known else None, EMERGENCY_STOP, "not pressed")


def _flag(good: bool | None, objection: Objection, text: str) -> Result:
    if good is None:
        return Result(Status.WARN, "the robot does not say it", _SILENT)
    return Result(Status.OK, text) if good else _joined([objection])


def _taskable(info: RobotInfo) -> Result:
    taskable = is_taskable(info)
    if taskable is None:
        return Result(Status.WARN, "the robot does not say it", _SILENT)
    if taskable:
        return Result(Status.OK, "it says that it can take a task")
    told = {*_MODES, NOT_INITIALISED, LOST, EMERGENCY_STOP}
    if rest := [objection for objection in objections(info) if objection not in told]:
        return _joined(rest)
    return Result(Status.FAIL, "it cannot take a task, for the reasons above", "mend those first")


def _clock(told: _Told, max_skew: float) -> Result:
    if told.skew is None:
        return Result(
            Status.WARN,
            "the answer carries no time",
            "protobuf and old firmware have none: compare the clocks by other means",
        )
    # the answer was made at any moment of the round trip
    if abs(told.skew) <= max_skew + told.round_trip / 2:
        return Result(Status.OK, f"differs by {abs(told.skew):.2f} s")
    which = "ahead of" if told.skew > 0 else "behind"
    return Result(
        Status.WARN,
        f"the robot's clock is {_span(abs(told.skew))} {which} this computer's",
        "set both by the same time server (NTP); until then times in status codes and tasks are "
        "off by as much",
    )


_UNITS = (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))


def _span(seconds: float) -> str:
    for name, size in _UNITS:
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.1f} s"
