"""The only request of the doctor: RobotInfo."""

from __future__ import annotations

import time
from typing import NamedTuple

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.codecs.choice import client_codec
from woosh_robot_agent.link.codecs.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.link.transport.base import Transport, TransportClosedError
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.tools.doctor.result import CheckFailedError, Result, Status
from woosh_robot_agent.tools.options import link_arguments

_SN = 1
"""Serial number of the request."""


class RobotInfoAnswer(NamedTuple):
    """The robot's answer.

    Attributes:
        info: Body of the answer.
        skew: Time by which the robot's clock is ahead of this computer's, in seconds; None if the
            answer carries no time.
        round_trip: Time from request to answer, in seconds.
    """

    info: RobotInfo
    skew: float | None
    round_trip: float


async def request_robot_info(transport: Transport, config: LinkConfig) -> RobotInfoAnswer:
    """Request RobotInfo.

    Raises:
        CheckFailedError: No answer, a refusal, or an answer that cannot be read.
    """
    codec = client_codec(config)
    invalid_frames: list[FrameError] = []
    sent_at = time.time()
    try:
        await transport.send(
            codec.encode(
                full_name(RobotInfo),
                RobotInfo(robot_id=config.robot_id or None),
                sn=_SN,
                timestamp=round(sent_at * 1000),
            )
        )
        answer = await run_with_timeout(
            config.handshake_timeout, _receive_answer(transport, codec, invalid_frames)
        )
    except TransportClosedError as error:
        raise CheckFailedError(
            f"the robot closed the connection after the request: {error}",
            "check --port, --transport and --encoding; if they are right, the robot's program is "
            "faulty: switch the robot off and on",
        ) from None
    except TimeoutError:
        raise CheckFailedError(
            f"no answer within {config.handshake_timeout:g} s"
            + (
                f", only frames that cannot be read: {invalid_frames[-1]}" if invalid_frames else ""
            ),
            "check --port, --transport, --encoding and --robot-id; if they are right, the robot's "
            "program hangs: switch the robot off and on",
        ) from None
    received_at = time.time()
    info = _body(codec, answer, config)
    half_way = (sent_at + received_at) / 2
    skew = answer.timestamp / 1000 - half_way if answer.timestamp else None
    return RobotInfoAnswer(info, skew, received_at - sent_at)


async def _receive_answer(
    transport: Transport, codec: Codec, invalid_frames: list[FrameError]
) -> Envelope:
    while True:
        try:
            envelope = codec.decode(await transport.recv())
        except FrameError as error:
            invalid_frames.append(error)
        else:
            if envelope.sn == _SN:
                return envelope


def _body(codec: Codec, answer: Envelope, config: LinkConfig) -> RobotInfo:
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
            "the firmware may be newer than this package: make a recording with "
            f"`record {link_arguments(config)}` and report the problem",
        ) from None


def check_identity(answer: RobotInfoAnswer) -> Result:
    """Report which robot has answered; never fails."""
    general = answer.info.genral
    parts = [
        f"robot {answer.info.robot_id or general.serial_number}",
        general.display_model,
        f"software {general.version.rc}" if general.version.rc else "",
        f"answered in {answer.round_trip * 1000:.0f} ms",
    ]
    return Result(Status.OK, ", ".join(part for part in parts if part))
