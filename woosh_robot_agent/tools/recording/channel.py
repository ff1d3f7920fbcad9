"""Channels of an MCAP file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set


@dataclass(frozen=True, eq=False)
class Channel:
    """A channel, which is registered in a file with its first message there.

    Attributes:
        topic: Name of the channel.
        schema_name: Name of the messages' type.
        schema: Definition of the type and of all types that it uses.
        schema_encoding: Language of the definition.
        message_encoding: Encoding of the messages.
        metadata: Further properties.
    """

    topic: str
    schema_name: str
    schema: bytes
    schema_encoding: str = SchemaEncoding.Protobuf
    message_encoding: str = MessageEncoding.Protobuf
    metadata: dict[str, str] = field(default_factory=dict)


def protobuf_channel(topic: str, cls: Any) -> Channel:
    """Return a channel for messages of a protobuf class."""
    schema = build_file_descriptor_set(cls).SerializeToString()
    return Channel(topic, cls.DESCRIPTOR.full_name, schema)
