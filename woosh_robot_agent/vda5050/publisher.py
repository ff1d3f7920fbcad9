"""Publishing the messages of a vehicle: headers, topics, QoS."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

from woosh_robot_agent.vda5050.model.state import ConnectionState
from woosh_robot_agent.vda5050.mqtt import MqttConnection, Publication
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.header import HeaderIds, Identity, header
from woosh_robot_agent.vda5050.protocol.topics import Topic


class Publisher:
    """Makes the messages of a vehicle, and publishes them.

    Args:
        version: version of the standard.
        identity: manufacturer and serial number of the vehicle.
        interface: first level of the topics.
        header_ids: number of the last message of each topic.
    """

    def __init__(
        self, version: Version, identity: Identity, interface: str, header_ids: HeaderIds
    ) -> None:
        self.version = version
        self.identity = identity
        major = version.number.split(".")[0]
        self._prefix = f"{interface}/v{major}/{identity.manufacturer}/{identity.serial_number}/"
        self._header_ids = header_ids
        self.state_id: int | None = None
        """Header id of the last state; None if there was none."""

    def topic(self, topic: Topic) -> str:
        """Return the full name of a topic."""
        return self._prefix + topic.value

    def last_will(self) -> Publication:
        """Return the message that the broker publishes when the connection breaks."""
        return self._message(Topic.CONNECTION, self.version.connection(ConnectionState.BROKEN))

    def publish(self, mqtt: MqttConnection, topic: Topic, content: Mapping[str, Any]) -> None:
        """Publish a message with this content."""
        if mqtt.connected:
            mqtt.publish(self._message(topic, content))

    def _message(self, topic: Topic, content: Mapping[str, Any]) -> Publication:
        head = header(
            self.identity, self.version.number, self._header_ids.next(topic.value), time.time()
        )
        if topic is Topic.STATE:
            self.state_id = head["headerId"]
        payload = json.dumps(head | dict(content), separators=(",", ":"), allow_nan=False)
        return Publication(self.topic(topic), payload, *self.version.quality[topic])
