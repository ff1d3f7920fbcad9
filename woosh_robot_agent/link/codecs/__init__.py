"""Encodings of frames: JSON text and protobuf bytes."""

from __future__ import annotations

from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.frames import Codec

JSON: Codec = JsonCodec(defaults=True)
"""JSON as a chassis writes it."""
PROTOBUF: Codec = ProtobufCodec()
"""Protobuf, which both ends write alike."""
_CLIENT_JSON: Codec = JsonCodec()
"""JSON as a client writes it: without the fields that have their default value."""


def client_codec(config: LinkConfig) -> Codec:
    """Return the codec that a client with this configuration uses; TCP always carries protobuf."""
    uses_json = config.transport == "websocket" and config.encoding == "json"
    return _CLIENT_JSON if uses_json else PROTOBUF


def server_codec(frame: str | bytes) -> Codec:
    """Return the codec for a client's frame and its answer: JSON for text, protobuf for bytes.

    A server learns the encoding of each client from the client's frames.
    """
    return JSON if isinstance(frame, str) else PROTOBUF
