"""The protobuf message in each frame, for the channels of the chassis's types."""

from __future__ import annotations

from typing import Any, NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.endpoints import COMMANDS
from woosh_robot_agent.link.codecs.choice import server_codec
from woosh_robot_agent.link.codecs.frames import SUBSCRIPTION_TYPE, Envelope, FrameError
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.protos import full_name, message_types
from woosh_robot_agent.tools.recording.channel import Channel, protobuf_channel
from woosh_robot_agent.tools.recording.records import Side

_ANSWERS = {command.request: command.answer for command in COMMANDS if command.two_types}
"""Types of the answers whose frame may name the type of the request."""
_MAX_TIMESTAMP = 2**63 // 1_000_000
"""First timestamp that is no valid time, in ms."""


class DecodedFrame(NamedTuple):
    """The message in a frame.

    Attributes:
        channel: Channel of the message's type and direction.
        message: The message.
        sent: Time of sending by the sender's clock, in ns; None if the frame does not give it.
    """

    channel: Channel
    message: Message
    sent: int | None


class MessageDecoder:
    """Decodes frames."""

    def __init__(self) -> None:
        self._channels: dict[tuple[Side, str], tuple[Any, Channel] | None] = {}
        """Class and channel by sender and type; None for a type that the schema does not have."""

    def decode(self, sender: Side, frame: str | bytes) -> DecodedFrame | None:
        """Return the message in a frame.

        Args:
            sender: Side that sent the frame.
            frame: The frame.

        Returns:
            None if the frame has none: it is invalid, of an unknown type, or refuses a request.
        """
        codec = server_codec(frame)
        try:
            envelope = codec.decode(frame)
            if envelope.ok is False:
                return None
            found = self._find(sender, envelope)
            if found is None:
                return None
            cls, channel = found
            return DecodedFrame(channel, codec.body(envelope, cls), _sent(envelope))
        except FrameError:
            return None

    def _find(self, sender: Side, envelope: Envelope) -> tuple[Any, Channel] | None:
        name = envelope.type
        if name == SUBSCRIPTION_TYPE:
            name = full_name(Subscription)
        elif sender == "chassis" and envelope.ok is not None:
            name = _ANSWERS.get(name, name)
        key = sender, name
        if key not in self._channels:
            cls = message_types().get(name)
            if cls is None:  # not remembered, because a hostile robot could send any number of them
                return None
            topic = f"/{sender}/{name.removeprefix('woosh.').replace('.', '/')}"
            self._channels[key] = cls, protobuf_channel(topic, cls)
        return self._channels[key]


def _sent(envelope: Envelope) -> int | None:
    timestamp = envelope.timestamp
    if timestamp is None or not 0 < timestamp < _MAX_TIMESTAMP:
        return None
    return timestamp * 1_000_000
