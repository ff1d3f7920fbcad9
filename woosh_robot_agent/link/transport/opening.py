"""Opening the transport that a configuration asks for."""

from __future__ import annotations

import asyncio
from typing import Any

from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.timeouts import cancel_and_wait
from woosh_robot_agent.link.transport.base import Transport
from woosh_robot_agent.link.transport.tcp import open_tcp
from woosh_robot_agent.link.transport.websocket import open_websocket


async def open_transport(config: LinkConfig) -> Transport:
    """Connect to a chassis.

    Raises:
        OSError: nothing answers at the address, or not in time.
        TransportClosedError: the other end does not speak this transport.
    """
    made: list[Any] = []
    opener = open_websocket if config.transport == "websocket" else open_tcp
    opening: asyncio.Future[Transport] = asyncio.ensure_future(opener(config, made))
    try:
        await asyncio.wait({opening}, timeout=config.connect_timeout)
        if not opening.done():
            raise TimeoutError(f"no connection within {config.connect_timeout:g} s")
        return opening.result()
    except BaseException:
        for socket in made:  # first: otherwise websockets may wait for an orderly close
            if transport := getattr(socket, "transport", None):
                transport.abort()
        await cancel_and_wait(opening)
        raise
