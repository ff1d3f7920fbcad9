"""All checks of the doctor, in order. They request RobotInfo once and never command the robot."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import replace

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.tools.doctor.clock import check_clock
from woosh_robot_agent.tools.doctor.connection import (
    find_reachable,
    open_link,
    own_address,
    resolve,
)
from woosh_robot_agent.tools.doctor.readiness_checks import (
    check_codes,
    check_emergency_stop,
    check_initialisation,
    check_localisation,
    check_mode,
    check_taskable,
)
from woosh_robot_agent.tools.doctor.result import CheckFailedError, Result, Status
from woosh_robot_agent.tools.doctor.robot_info import check_identity, request_robot_info

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
"""Names of the checks, in order."""
NOT_REACHED = "not checked, because an earlier check failed"
"""Text of the checks that were not reached."""


async def examine(config: LinkConfig, max_skew: float) -> AsyncIterator[Result]:
    """Check one robot; yield the result of each of `CHECKS` as soon as it is known.

    Args:
        config: Address and timeouts of the robot.
        max_skew: Maximum difference of the clocks, in seconds.
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
    address, closed = await find_reachable(config, await resolve(config))
    yield Result(Status.OK, f"{address.ip} is reachable from {own_address(address)}")
    if closed is not None:
        raise CheckFailedError(
            f"port {config.effective_port} is closed: {closed}",
            "check --port and --transport; if they are right, the robot's program is not running: "
            "wait until it has started, or switch the robot off and on",
        )
    yield Result(Status.OK, f"{config.effective_port} is open")
    transport = await open_link(config)
    try:
        is_tcp = config.transport == "tcp"
        yield Result(Status.OK, "not needed over tcp" if is_tcp else "the WebSocket is open")
        answer = await request_robot_info(transport, config)
    finally:
        await transport.close(config.close_timeout)
    yield check_identity(answer)
    yield check_mode(answer.info)
    yield check_initialisation(answer.info)
    yield check_localisation(answer.info)
    yield check_emergency_stop(answer.info)
    yield check_taskable(answer.info)
    yield check_codes(answer.info)
    yield check_clock(answer, max_skew)
