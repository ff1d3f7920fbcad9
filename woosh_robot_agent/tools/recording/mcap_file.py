"""One MCAP file that is being written."""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from pathlib import Path

from mcap.writer import Writer

from woosh_robot_agent.tools.recording.channel import Channel

_CHUNK_SIZE = 1024 * 1024
"""Size of the messages above which a chunk is compressed and written, in bytes."""
_NEVER = 2**62
"""Chunk size with which the library itself never ends a chunk."""
_LIBRARY = "woosh_robot_agent"
# Upper bounds of the sizes of parts, in bytes, without the names and texts in them.
_MESSAGE_OVERHEAD = 64
_RECORD_OVERHEAD = 128
_PER_CHANNEL_AND_CHUNK = 64
_END_OVERHEAD = 512


class McapFile:
    """Writes one file in chunks, so that it can be read up to the last chunk after a crash.

    Args:
        path: Path of the new file; it must not exist.
        profile: Profile in the header of the file.

    Attributes:
        path: Path of the file.
        written: Number of messages in the file, by topic.
        pending: Number of messages in the chunk that is not written yet, by topic.
        max_size: Maximum size that the complete file would have if it were closed now, in bytes.

    Raises:
        OSError: The file cannot be created.
    """

    def __init__(self, path: Path, profile: str) -> None:
        self.path = path
        self.written: Counter[str] = Counter()
        self.pending: Counter[str] = Counter()
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=_NEVER)
        self._writer.start(profile=profile, library=_LIBRARY)
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[Channel, int] = {}
        self.max_size = 0
        self._pending_size = 0
        """Maximum size of the chunk that is not written yet, in bytes."""
        self._end_size = _END_OVERHEAD
        """Maximum size of what `close` will write after the last chunk, in bytes."""
        self._size = 0
        """Size of the complete chunks, attachments and metadata, in bytes."""
        self.flush()

    def add(self, channel: Channel, log_time: int, publish_time: int, data: bytes) -> None:
        """Add a message to the chunk; write the chunk if it is full.

        Args:
            channel: Channel of the message.
            log_time: Time of recording, in ns.
            publish_time: Time of sending by the sender's clock, in ns.
            data: The message.
        """
        number = self._channels.get(channel)
        if number is None:
            number = self._register(channel)
        topic = channel.topic
        self._writer.add_message(
            number, log_time, data, publish_time, self.written[topic] + self.pending[topic]
        )
        self.pending[topic] += 1
        size = len(data) + _MESSAGE_OVERHEAD
        self._pending_size += size
        self.max_size += size
        if self._pending_size > _CHUNK_SIZE:
            self.flush()

    def room_for(self, channel: Channel, data: bytes) -> int:
        """Return the maximum size by which a message would make the file larger, in bytes."""
        size = len(data) + _MESSAGE_OVERHEAD
        return size if channel in self._channels else size + 2 * _definition_size(channel)

    def attach(self, name: str, media_type: str, data: bytes, log_time: int) -> None:
        """Write an attachment."""
        self.flush()
        self._writer.add_attachment(log_time, log_time, name, media_type, data)
        self._end_size += len(name) + len(media_type) + _RECORD_OVERHEAD
        self.flush()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write metadata."""
        self.flush()
        self._writer.add_metadata(name, values)
        self._end_size += len(name) + _RECORD_OVERHEAD
        self.flush()

    def flush(self) -> None:
        """Complete the chunk and pass it on to the operating system."""
        if self.pending:
            self._end_size += self._chunk_end_size()
        self._writer.flush()
        self._size = self._file.tell()
        self._pending_size = 0
        self._update_max_size()
        self.written.update(self.pending)
        self.pending.clear()

    def close(self) -> None:
        """Complete and close the file."""
        self.flush()
        self._writer.finish()
        self._file.close()

    def abandon(self) -> None:
        """Close the file after an error, and cut off what is not complete."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            os.truncate(self.path, self._size)

    def _register(self, channel: Channel) -> int:
        key = (channel.schema_name, channel.schema_encoding)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(
                channel.schema_name, channel.schema_encoding, channel.schema
            )
        number = self._channels[channel] = self._writer.register_channel(
            channel.topic, channel.message_encoding, self._schemas[key], channel.metadata
        )
        # definitions are in the chunk and, for readers that jump to it, at the end
        size = _definition_size(channel)
        self._pending_size += size
        self._end_size += size
        self._update_max_size()
        return number

    def _update_max_size(self) -> None:
        self.max_size = self._size + self._pending_size + self._end_size + self._chunk_end_size()

    def _chunk_end_size(self) -> int:
        """Return the maximum size that the indexes of the current chunk add, in bytes."""
        return _RECORD_OVERHEAD + len(self._channels) * _PER_CHANNEL_AND_CHUNK


def _definition_size(channel: Channel) -> int:
    metadata = sum(len(name) + len(value) for name, value in channel.metadata.items())
    names = 2 * len(channel.topic) + 2 * len(channel.schema_name)
    return len(channel.schema) + names + 4 * metadata + 2 * _RECORD_OVERHEAD
