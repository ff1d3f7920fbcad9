"""Publication of the messages of a vehicle: headers, topics, QoS."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from woosh_robot_agent.vda5050.model.state import ConnectionState
from woosh_robot_agent.vda5050.mqtt import MqttConnection, Publication
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.header import HeaderIds, Identity, header
from woosh_robot_agent.vda5050.protocol.topics import PUBLISHED, Topic

_OWN_CONNECTIONS = 64
"""Number of own `connection` messages that are remembered."""


class Publisher:
    """Adds headers to the messages of a vehicle, and publishes them on their topics.

    Args:
        version: version of the standard.
        identity: manufacturer and serial number of the vehicle.
        interface: first level of the topics.
        header_ids: header ids of the messages.
    """

    def __init__(
        self, version: Version, identity: Identity, interface: str, header_ids: HeaderIds
    ) -> None:
        self.version = version
        self.identity = identity
        major = version.number.split(".")[0]
        self._prefix = f"{interface}/v{major}/{identity.manufacturer}/{identity.serial_number}/"
        self._header_ids = header_ids
        self._will_id = -1
        """Header id of the last will of the last connection."""
        self._will = b""
        """The last will of the last attempt to connect."""
        self._connections: deque[bytes] = deque(maxlen=_OWN_CONNECTIONS)
        """The last `connection` messages, with the last wills of the connections."""
        self.state_id: int | None = None
        """Header id of the last state; None if there was none."""

    def topic(self, topic: Topic) -> str:
        """Return the full name of a topic."""
        return self._prefix + topic.value

    def last_will(self) -> Publication:
        """Return the message that the broker publishes when the connection breaks.

        Its header id follows that of the first message of the connection, ONLINE.
        """
        topic = Topic.CONNECTION
        ids = self._header_ids
        self.connection_lost()
        self._will_id = ids.peek(topic.value) + 1
        will = self._message(
            topic, self.version.connection(ConnectionState.BROKEN), header_id=self._will_id
        )
        self._will = will.payload.encode()
        return will

    def connection_lost(self) -> None:
        """Skip the header id of the last will: the broker may have published it."""
        if self._header_ids.peek(Topic.CONNECTION.value) == self._will_id:
            self._header_ids.next(Topic.CONNECTION.value)

    def is_own_connection(self, payload: bytes) -> bool:
        """Return True if this publisher has made a `connection` message."""
        return payload == self._will or payload in self._connections

    def publish(self, mqtt: MqttConnection, topic: Topic, content: Mapping[str, Any]) -> None:
        """Publish a message; drop it if there is no connection."""
        if not mqtt.connected:
            return
        publication = self._message(topic, content)
        if topic is Topic.CONNECTION:
            self._connections += (self._will, publication.payload.encode())
        mqtt.publish(publication)

    def _message(
        self, topic: Topic, content: Mapping[str, Any], header_id: int | None = None
    ) -> Publication:
        if header_id is None:
            header_id = self._header_ids.next(topic.value)
        head = header(self.identity, self.version.number, header_id, time.time())
        if topic is Topic.STATE:
            self.state_id = header_id
        payload = json.dumps(head | dict(content), separators=(",", ":"), allow_nan=False)
        return Publication(self.topic(topic), payload, *PUBLISHED[topic])
