"""The start of a link: open the transport, renew subscriptions, wait for the first RobotInfo."""

from __future__ import annotations

import asyncio

from woosh_robot_agent.link.answer import Answer
from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.connection import Connection
from woosh_robot_agent.link.errors import HandshakeError, NotConnectedError
from woosh_robot_agent.link.log_once import LogOnce, one_line
from woosh_robot_agent.link.subscriptions import Subscriptions
from woosh_robot_agent.link.timeouts import cancel_and_wait
from woosh_robot_agent.link.transport.base import Transport, TransportClosedError
from woosh_robot_agent.link.transport.opening import open_transport
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name

_RETRY_AFTER = 1.0
"""Time without an answer after which RobotInfo is requested once more, in seconds."""


async def open_link(config: LinkConfig) -> Transport:
    """Connect to the chassis.

    Raises:
        NotConnectedError: nothing answers at the address.
        HandshakeError: the other end does not speak the configured transport.
    """
    try:
        return await open_transport(config)
    except OSError as error:
        raise NotConnectedError(error.strerror or str(error) or type(error).__name__) from None
    except TransportClosedError as error:
        raise HandshakeError(str(error)) from None


async def handshake(
    connection: Connection, subscriptions: Subscriptions, config: LinkConfig, log: LogOnce
) -> None:
    """Renew the subscriptions and request RobotInfo; the link is ready with its answer.

    Args:
        connection: a new connection.
        subscriptions: the subscriptions to renew; gets the RobotInfo.
        config: timeout, and id of the robot.
        log: log for a RobotInfo that cannot be read.

    Raises:
        LinkError: the connection ended, or no answer arrived in time.
        HandshakeError: the answer is not a RobotInfo.
    """
    subscriptions.hold()
    try:
        connection.subscribe(subscriptions.wanted, on=True)
        answer = await _request_info(connection, subscriptions, config)
        _check(answer, log)
        subscriptions.release()
    finally:
        subscriptions.discard_held()


def _check(answer: Answer, log: LogOnce) -> None:
    if not answer.ok or answer.type != full_name(RobotInfo):
        reason = answer.msg if not answer.ok else answer.defect or "another type of answer"
        raise HandshakeError(f"the chassis did not send its RobotInfo: {one_line(reason)}")
    if answer.defect:  # perhaps from newer firmware; everything else may work
        log.warn("no snapshot", f"the first values are missing because {answer.defect}")


async def _request_info(
    connection: Connection, subscriptions: Subscriptions, config: LinkConfig
) -> Answer:
    """Request RobotInfo, and again if no answer comes, since a single frame may be lost."""
    remaining = config.handshake_timeout
    message = RobotInfo(robot_id=config.robot_id or None)
    requests: set[asyncio.Task[Answer]] = set()
    try:
        while True:
            request = connection.request(message, remaining, tap=subscriptions.put_snapshot)
            requests.add(asyncio.ensure_future(request))
            done, _ = await asyncio.wait(
                requests,
                timeout=_RETRY_AFTER if remaining > 2 * _RETRY_AFTER else None,
                return_when=asyncio.FIRST_COMPLETED,
            )
            if done:
                return done.pop().result()
            remaining -= _RETRY_AFTER
    except NotConnectedError:  # the connection ended before the request
        raise connection.ended.result() from None
    finally:
        await cancel_and_wait(*requests)
