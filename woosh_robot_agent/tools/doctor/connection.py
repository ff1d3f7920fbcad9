"""Connecting to the robot step by step: name, address, port, protocol."""

from __future__ import annotations

import asyncio
import errno
import socket
from typing import NamedTuple

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.link.transport.base import Transport, TransportClosedError
from woosh_robot_agent.link.transport.opening import open_transport
from woosh_robot_agent.tools.doctor.result import CheckFailedError
from woosh_robot_agent.tools.link_report import system_text


class Address(NamedTuple):
    """Numeric IP address and port."""

    ip: str
    port: int


async def resolve(config: LinkConfig) -> list[Address]:
    """Return the addresses of the robot.

    Raises:
        CheckFailedError: The host name has no address.
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
    return [Address(str(address[0]), int(address[1])) for *_, address in found]


async def find_reachable(
    config: LinkConfig, addresses: list[Address]
) -> tuple[Address, str | None]:
    """Return the first address with an open port, or else a reachable one.

    A name can have several addresses, and the robot need not listen on the first one.

    Returns:
        The address, and why its port is closed; None if it is open.

    Raises:
        CheckFailedError: No address is reachable.
    """
    closed: tuple[Address, str | None] | None = None
    failure: CheckFailedError | None = None
    for address in addresses:
        try:
            reason = await _try_port(config, address)
        except CheckFailedError as error:
            failure = error
            continue
        if reason is None:
            return address, None
        closed = address, reason
    if closed is None:
        assert failure is not None
        raise failure
    return closed


async def _try_port(config: LinkConfig, address: Address) -> str | None:
    """Connect and disconnect; return why the port is closed, or None if it is open."""
    try:
        _, writer = await run_with_timeout(
            config.connect_timeout, asyncio.open_connection(*address)
        )
    except ConnectionError as error:  # sent by the other end, which is therefore reachable
        return system_text(error)
    except TimeoutError:
        raise CheckFailedError(
            f"{address.ip} did not answer within {config.connect_timeout:g} s",
            "check that the robot is switched on and in this network, that --ip is right, and that "
            f"no firewall blocks port {config.effective_port}",
        ) from None
    except OSError as error:
        has_no_route = error.errno in (errno.ENETUNREACH, errno.EADDRNOTAVAIL)
        raise CheckFailedError(
            f"{address.ip} cannot be reached: {system_text(error)}",
            "connect this computer to the robot's network, with an address in the same subnet"
            if has_no_route
            else "check that the robot is switched on and in this network, and that --ip is right",
        ) from None
    writer.transport.abort()
    return None


def own_address(address: Address) -> str:
    """Return this computer's address on the route to `address`; sends nothing."""
    family = socket.AF_INET6 if ":" in address.ip else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)
        return str(probe.getsockname()[0])


async def open_link(config: LinkConfig) -> Transport:
    """Open the configured transport.

    Raises:
        CheckFailedError: The other end does not speak it, does not answer, or disconnects.
    """
    try:
        return await open_transport(config)
    except TransportClosedError as error:
        raise CheckFailedError(
            f"the program on this port is not a chassis: {error}",
            "check --port and --transport; a proxy or another program may use the port",
        ) from None
    except TimeoutError:
        raise CheckFailedError(
            f"the connection was accepted, but no answer came within {config.connect_timeout:g} s",
            "check --port and --transport; if they are right, the robot's program hangs: switch "
            "the robot off and on",
        ) from None
    except OSError as error:
        raise CheckFailedError(
            f"the connection was lost: {system_text(error)}",
            "try again; if it happens repeatedly, the network or the robot's program is unstable",
        ) from None
