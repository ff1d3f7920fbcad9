"""The checks of the doctor, each with a result that names cause and remedy."""

from __future__ import annotations

import asyncio
import errno
import socket
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.codecs import JSON, client_codec
from woosh_robot_agent.link.codecs.json_codec import to_json
from woosh_robot_agent.link.config import url_host
from woosh_robot_agent.link.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.protos import enum_name, full_name
from woosh_robot_agent.link.reports import system_text
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.link.transport import Transport, TransportClosedError, open_transport
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.robot.clock import TOLERANCE, describe_offset
from woosh_robot_agent.robot.readiness import (
    CONTROL_MODES,
    DEPLOYMENT,
    EMERGENCY_STOP,
    LOST,
    NO_WORK_MODE,
    NOT_INITIALISED,
    SCHEDULE,
    Objection,
    accepts_task,
    all_objections,
    is_located,
    objections,
    pose_problem,
)
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.tools.options import Address, link_arguments, own_address


class Status(Enum):
    """Outcome of a check."""

    OK = "ok"
    WARN = "warn"
    FAIL = "FAIL"  # in capitals, so that it is seen in a long list
    SKIPPED = "skip"


@dataclass(frozen=True)
class Result:
    """Result of one check.

    Attributes:
        text: what was found.
        remedy: what to do about it; empty if nothing has to be done.
        check: name of the check; empty in the results of the checks below, filled in by `examine`.
    """

    status: Status
    text: str
    remedy: str = ""
    check: str = ""


class CheckFailedError(Exception):
    """A check failed on which all later checks depend; `result` is its result."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.result = Result(Status.FAIL, text, remedy)


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
    "status codes",
    "clock",
)
"""Names of the checks of the robot, in order."""
NOT_REACHED = "not checked, because an earlier check failed"
"""Text of the checks that were not reached."""


async def examine(config: LinkConfig, max_skew: float = TOLERANCE) -> AsyncIterator[Result]:
    """Check one robot; yield the result of each of `CHECKS` as soon as it is known.

    `max_skew` is the maximum difference of the clocks, in seconds.
    """
    names = iter(CHECKS)
    try:
        async for result in _run_checks(config, max_skew):
            yield replace(result, check=next(names))
    except CheckFailedError as error:
        yield replace(error.result, check=next(names))
    for name in names:
        yield Result(Status.SKIPPED, NOT_REACHED, check=name)


async def _run_checks(config: LinkConfig, max_skew: float) -> AsyncIterator[Result]:
    """Yield the results in the order of `CHECKS`, without the names of the checks."""
    address, closed_reason = await _find_reachable(config)
    yield Result(Status.OK, f"{address.ip} is reachable from {own_address(*address)}")
    if closed_reason:
        raise CheckFailedError(
            f"port {config.effective_port} is closed: {closed_reason}",
            "check --ip and --transport; if they are right, the robot's program is not running: "
            "wait until it has started, or switch the robot off and on",
        )
    yield Result(Status.OK, f"{config.effective_port} is open")
    transport = await _open_link(config)
    try:
        is_tcp = config.transport == "tcp"
        yield Result(Status.OK, "not needed over tcp" if is_tcp else "the WebSocket is open")
        answer = await _request_robot_info(transport, config)
    finally:
        await transport.close(config.close_timeout)
    yield _check_identity(answer)
    yield check_mode(answer.info)
    yield check_initialisation(answer.info)
    yield check_localisation(answer.info)
    yield _check_emergency_stop(answer.info)
    yield _check_taskable(answer.info)
    yield check_codes(answer.info)
    yield _check_clock(answer, max_skew)


_MAX_BODY = 64 * 1024 * 1024
"""Number of bytes after which the rest of an HTTP response is not read."""
_SN = 1
"""Serial number of the request for RobotInfo."""


class RobotInfoAnswer(NamedTuple):
    """The robot's answer to the request for RobotInfo.

    Attributes:
        skew: time by which the robot's clock is ahead of this computer's, in seconds; None if the
            answer carries no time.
        round_trip: time from request to answer, in seconds.
    """

    info: RobotInfo
    skew: float | None
    round_trip: float


async def _request_robot_info(transport: Transport, config: LinkConfig) -> RobotInfoAnswer:
    """Request RobotInfo.

    Raises:
        CheckFailedError: no answer, a refusal, or an answer that cannot be read.
    """
    codec = client_codec(config)
    unusable: list[str] = []  # descriptions of frames that came instead of the answer
    sent_at = time.time()
    try:
        await transport.send(
            codec.encode(
                full_name(RobotInfo),
                RobotInfo(robot_id=config.robot_id or None),  # without a gateway, it is left out
                sn=_SN,
                timestamp=round(sent_at * 1000),
            )
        )
        answer = await run_with_timeout(
            config.handshake_timeout, _receive_answer(transport, codec, unusable)
        )
    except TransportClosedError as error:
        raise CheckFailedError(
            f"the robot closed the connection after the request: {error}",
            "check --ip, --transport and --encoding; if they are right, the robot's program is "
            "faulty: switch the robot off and on",
        ) from None
    except TimeoutError:
        raise CheckFailedError(
            f"no answer within {config.handshake_timeout:g} s"
            + (f", only {unusable[-1]}" if unusable else ""),
            "check --ip, --transport, --encoding and --robot-id; if they are right, "
            + (
                f"the firmware is not supported: {_report(config)}"
                if unusable
                else "the robot's program hangs: switch the robot off and on"
            ),
        ) from None
    received_at = time.time()
    info = _robot_info_in(codec, answer, config)
    answered_at = (sent_at + received_at) / 2  # if both ways took the same time
    skew = answer.timestamp / 1000 - answered_at if answer.timestamp else None
    return RobotInfoAnswer(info, skew, received_at - sent_at)


def _report(config: LinkConfig) -> str:
    """Return how to report a robot that answers in an unknown way."""
    return f"make a recording with `record {link_arguments(config)}` and report the problem"


async def _receive_answer(transport: Transport, codec: Codec, unusable: list[str]) -> Envelope:
    """Return the answer; append descriptions of unusable frames to `unusable`."""
    while True:
        try:
            envelope = codec.decode(await transport.recv())
        except FrameError as error:
            unusable.append(f"frames that cannot be read: {error}")
        else:
            if envelope.sn == _SN:
                return envelope
            if envelope.sn:
                unusable.append(f"an answer with the serial number {envelope.sn} instead of {_SN}")


def _robot_info_in(codec: Codec, answer: Envelope, config: LinkConfig) -> RobotInfo:
    """Return the RobotInfo in an answer; raise CheckFailedError if it has none."""
    if not answer.ok:
        raise CheckFailedError(
            f"the robot refused the request: {answer.msg or 'no reason given'}",
            "check --robot-id, and resolve the reason that the robot gave",
        )
    if answer.type != full_name(RobotInfo):
        raise CheckFailedError(
            f"the answer is of another type: {answer.type or 'none'}",
            "this is not a supported robot, or its firmware is not supported",
        )
    try:
        return codec.body(answer, RobotInfo)
    except FrameError as error:
        raise CheckFailedError(
            f"the answer cannot be read: {error}",
            f"the firmware may be newer than this package: {_report(config)}",
        ) from None


def _check_identity(answer: RobotInfoAnswer) -> Result:
    """Report which robot has answered; never fails."""
    general = answer.info.genral  # spelled so in the robot's messages
    parts = [
        f"robot {answer.info.robot_id or general.serial_number}",
        general.display_model,
        f"software {general.version.rc}" if general.version.rc else "",
        f"answered in {answer.round_trip * 1000:.0f} ms",
    ]
    return Result(Status.OK, ", ".join(part for part in parts if part))


def _check_clock(answer: RobotInfoAnswer, max_skew: float) -> Result:
    """Check that the clocks differ by no more than `max_skew` seconds."""
    if answer.skew is None:
        return Result(
            Status.WARN,
            "the answer carries no time",
            "protobuf frames and old firmware have none: compare the clocks by other means",
        )
    # The robot may have created the answer at any moment of the round trip.
    if abs(answer.skew) <= max_skew + answer.round_trip / 2:
        return Result(Status.OK, f"differs by {abs(answer.skew):.2f} s")
    return Result(
        Status.WARN,
        f"the robot's clock is {describe_offset(answer.skew)}",
        "synchronise both with the same time server (NTP); until then the times in status codes "
        "and tasks are wrong by this difference; stamps of ROS messages are not affected, because "
        "the agent takes them from this computer's clock",
    )


async def _find_reachable(config: LinkConfig) -> tuple[Address, str]:
    """Return the first address of the robot with an open port, or else a reachable address.

    A name can have several addresses, and the robot need not listen on the first one.

    Returns:
        The numeric address, and why its port is closed; empty if it is open.

    Raises:
        CheckFailedError: the host name has no address, or no address is reachable.
    """
    loop = asyncio.get_running_loop()
    lookup = loop.getaddrinfo(config.ip, config.effective_port, type=socket.SOCK_STREAM)
    try:
        found = await run_with_timeout(config.connect_timeout, lookup)
    except (TimeoutError, OSError, UnicodeError) as error:
        raise CheckFailedError(
            f"the host name {config.ip} cannot be resolved: {error}",
            "check its spelling, or give --ip a numeric address",
        ) from None
    closed: tuple[Address, str] | None = None
    failure: CheckFailedError | None = None
    for *_, found_address in found:
        # as text, which has the interface of a link-local address, e.g. fe80::1%eth0
        ip, port = socket.getnameinfo(found_address, socket.NI_NUMERICHOST | socket.NI_NUMERICSERV)
        address = Address(ip, int(port))
        opening = asyncio.open_connection(*address)
        try:
            _, writer = await run_with_timeout(config.connect_timeout, opening)
        except ConnectionError as error:  # sent by the other end, which is therefore reachable
            closed = address, system_text(error)
        except OSError as error:
            failure = _unreachable_error(config, address, error)
        else:
            writer.transport.abort()
            return address, ""
    if closed is None:
        assert failure is not None
        raise failure
    return closed


def _unreachable_error(config: LinkConfig, address: Address, error: OSError) -> CheckFailedError:
    if isinstance(error, TimeoutError):
        return CheckFailedError(
            f"{address.ip} did not answer within {config.connect_timeout:g} s",
            "check that the robot is switched on and in this network, that --ip is right, and that "
            f"no firewall blocks port {config.effective_port}",
        )
    has_no_route = error.errno in (errno.ENETUNREACH, errno.EADDRNOTAVAIL)
    return CheckFailedError(
        f"{address.ip} cannot be reached: {system_text(error)}",
        "connect this computer to the robot's network, with an address in the same subnet"
        if has_no_route
        else "check that the robot is switched on and in this network, and that --ip is right",
    )


async def _open_link(config: LinkConfig) -> Transport:
    """Open the configured transport.

    Raises:
        CheckFailedError: the other end does not speak the transport, does not answer, or
            disconnects.
    """
    try:
        return await open_transport(config)
    except TransportClosedError as error:
        raise await _link_error(
            config,
            f"the program on this port is not a chassis: {error}",
            "check --ip and --transport; a proxy or another program may use the port",
            str(error),
        ) from None
    except TimeoutError:
        text = (
            f"the connection was accepted, but no answer came within {config.connect_timeout:g} s"
        )
        raise await _link_error(
            config,
            text,
            "check --ip and --transport; if they are right, the robot's program hangs: switch "
            "the robot off and on",
            text,
        ) from None
    except OSError as error:
        raise CheckFailedError(
            f"the connection was lost: {system_text(error)}",
            "try again; if it happens repeatedly, the network or the robot's program is unstable",
        ) from None


async def _link_error(config: LinkConfig, text: str, remedy: str, reason: str) -> CheckFailedError:
    """Return the error for a link that did not open. It tells what answers HTTP at this address.

    A chassis also answers HTTP on this port. If one does, no other program uses the port, but a
    proxy or firewall refuses the WebSocket.

    Args:
        text: what is wrong if no chassis answers HTTP either.
        remedy: what to do about it then.
        reason: why the link did not open, for the error if a chassis answers HTTP.
    """
    is_http = config.transport == "websocket"
    answer = await ask_over_http(config, RobotInfo(), config.connect_timeout) if is_http else None
    if answer is None:
        return CheckFailedError(text, remedy)
    info = _robot_info_over_http(answer)
    if info is None:
        found = f"{text}; HTTP is answered with status {answer.status}"
        by = f" by {answer.server}" if answer.server else ""
        return CheckFailedError(f"{found}{by}", remedy)
    number = info.robot_id or info.genral.serial_number
    return CheckFailedError(
        f"robot {number} answers HTTP requests at this address, but its WebSocket cannot be "
        f"opened: {reason}",
        "a proxy or firewall between this computer and the robot lets only HTTP pass: let it pass "
        "the headers Upgrade and Connection too, or connect without it",
    )


class HttpAnswer(NamedTuple):
    """An answer over HTTP.

    Attributes:
        status: status of the response.
        server: the Server header; empty without one.
        envelope: the answer in the body; None if the body is no answer, or too long.
        delay: time from request to response, in seconds.
    """

    status: int
    server: str
    envelope: Envelope | None
    delay: float


async def ask_over_http(config: LinkConfig, request: Message, timeout: float) -> HttpAnswer | None:
    """Send a request over HTTP.

    Args:
        config: address of the robot, and the timeout of the connection.
        timeout: timeout of the answer, in seconds.

    Returns:
        The answer; None if nothing answers HTTP.
    """
    import aiohttp  # loads slowly, and is seldom needed

    path = full_name(request).replace(".", "/")
    url = f"http://{url_host(config.ip)}:{config.effective_port}/{path}"
    limits = aiohttp.ClientTimeout(total=timeout, sock_connect=config.connect_timeout)
    began = time.monotonic()
    try:
        async with (
            aiohttp.ClientSession(timeout=limits) as session,
            session.post(
                url, json=to_json(request, defaults=False), allow_redirects=False
            ) as response,
        ):
            body = bytearray()
            async for chunk in response.content.iter_any():
                body += chunk
                if len(body) > _MAX_BODY:
                    break
            delay = time.monotonic() - began
            try:
                envelope = JSON.decode(bytes(body))
            except FrameError:
                envelope = None
            return HttpAnswer(response.status, response.headers.get("Server", ""), envelope, delay)
    except (aiohttp.ClientError, asyncio.TimeoutError, OSError):  # nothing answers HTTP
        return None


def _robot_info_over_http(answer: HttpAnswer) -> RobotInfo | None:
    """Return the RobotInfo in an answer over HTTP; None if it has none."""
    if answer.envelope is None or answer.envelope.type != full_name(RobotInfo):
        return None
    try:
        return JSON.body(answer.envelope, RobotInfo)
    except FrameError:
        return None


_MODE_OBJECTIONS = (*CONTROL_MODES, DEPLOYMENT, SCHEDULE, NO_WORK_MODE)
"""The objections that `check_mode` reports."""
_NOT_REPORTED = Result(
    Status.WARN,
    "the robot does not report it",
    "look at the robot's own screen; its firmware may be too old to report it",
)


def check_mode(info: RobotInfo) -> Result:
    """Check the control mode and the work mode."""
    if not info.HasField("mode"):
        return _NOT_REPORTED
    if found := [objection for objection in objections(info) if objection in _MODE_OBJECTIONS]:
        return _failed(found)
    control = enum_name(robot.ControlMode, info.mode.ctrl)
    work = enum_name(robot.WorkMode, info.mode.work)
    return Result(Status.OK, f"control {control}, work {work}")


def check_initialisation(info: RobotInfo) -> Result:
    """Check that the robot is initialised."""
    if NOT_INITIALISED in objections(info):
        return _failed([NOT_INITIALISED])
    if info.state == robot.kStateUndefined:
        return _NOT_REPORTED
    if info.state == robot.kFault:
        return Result(Status.SKIPPED, "hidden by a fault: run doctor again when that is cleared")
    return Result(Status.OK, f"state {enum_name(robot.State, info.state)}")


def check_localisation(info: RobotInfo) -> Result:
    """Check that the robot knows its position, and that the position belongs to a map."""
    if info.state == robot.kUninit:
        return Result(Status.SKIPPED, "not checked until the robot is initialised")
    if info.state == robot.kMapping:
        return Result(Status.SKIPPED, "not checked while the robot is building a map")
    located = is_located(info)
    if located is None:
        return _NOT_REPORTED
    if not located:
        return _failed([LOST])
    if doubt := pose_problem(info):
        return Result(Status.WARN, doubt.reason, doubt.remedy)
    return Result(Status.OK, "the robot knows its position")


def _check_emergency_stop(info: RobotInfo) -> Result:
    """Check that the emergency stop is released."""
    if not info.HasField("device_state"):
        return _NOT_REPORTED
    if EMERGENCY_STOP in objections(info):
        return _failed([EMERGENCY_STOP])
    return Result(Status.OK, "not pressed")


def _check_taskable(info: RobotInfo) -> Result:
    """Check whether the robot would accept a new task."""
    reported_above = {*_MODE_OBJECTIONS, NOT_INITIALISED, LOST, EMERGENCY_STOP}  # by other checks
    found = all_objections(info)
    if others := [objection for objection in found if objection not in reported_above]:
        return _failed(others)
    if found:
        return Result(
            Status.FAIL,
            "the robot rejects tasks, for the reasons above",
            "resolve the failed checks above",
        )
    if accepts_task(info) is None:
        return _NOT_REPORTED
    return Result(Status.OK, "the robot accepts a new task")


def check_codes(info: RobotInfo) -> Result:
    """Report the unresolved problems in AbnormalCodes."""
    codes = [explained(code.code, code.msg) for code in info.abnormal_codes.scs]
    if codes:
        return Result(Status.WARN, "; ".join(codes), "resolve what the codes report")
    return Result(Status.OK, "no unresolved problem is reported")


def _failed(found: list[Objection]) -> Result:
    reasons = "; ".join(objection.reason for objection in found)
    remedies = "; ".join(dict.fromkeys(objection.remedy for objection in found))
    return Result(Status.FAIL, reasons, remedies)
