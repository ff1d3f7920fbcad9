"""When state, visualization, connection and factsheet are published, and their publication."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from woosh_robot_agent.vda5050.messages.factsheet import Factsheet
from woosh_robot_agent.vda5050.messages.protocol import (
    PUBLISHED,
    HeaderIds,
    Identity,
    Topic,
    Version,
    header,
)
from woosh_robot_agent.vda5050.messages.state import ConnectionState, RobotStatus, VehicleState
from woosh_robot_agent.vda5050.mqtt import MqttConnection, Publication
from woosh_robot_agent.vda5050.robot.status import Limits


class Schedule:
    """Calls a function soon after each change, and at regular intervals without one.

    Args:
        send: publishes the message.
        shortest: minimum time between two calls, in seconds.
        longest: maximum time between two calls, in seconds; infinite to call on changes only.
    """

    def __init__(
        self, send: Callable[[], None], shortest: float, longest: float = math.inf
    ) -> None:
        self._send = send
        self._shortest = shortest
        self._longest = longest
        self._last = -math.inf
        """Loop time of the last call."""
        self._timer: asyncio.TimerHandle | None = None

    def changed(self) -> None:
        """Call the function as soon as the minimum time since the last call is over."""
        self.call_within(self._shortest)

    def call_within(self, interval: float) -> None:
        """Call the function as soon as `interval` seconds since the last call are over."""
        loop = asyncio.get_running_loop()
        due = max(loop.time(), self._last + interval)
        if self._timer is None or self._timer.when() > due:
            self._arm(due)

    def stop(self) -> None:
        """Make no more calls."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _arm(self, due: float) -> None:
        self.stop()
        self._timer = asyncio.get_running_loop().call_at(due, self._call)

    def _call(self) -> None:
        self._last = asyncio.get_running_loop().time()
        self._timer = None
        if self._longest < math.inf:
            self._arm(self._last + self._longest)
        self._send()


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


class Reports:
    """Publishes the messages of a vehicle. Without a connection, none is queued.

    Args:
        limits: intervals of the messages.
        state: returns the state of the vehicle; None while it is unknown.
        robot: returns the state of the robot; None while it is unknown.
        factsheet: returns the factsheet; None while it is unknown.
    """

    def __init__(
        self,
        limits: Limits,
        state: Callable[[], VehicleState | None],
        robot: Callable[[], RobotStatus | None],
        factsheet: Callable[[], Factsheet | None],
    ) -> None:
        self._state = state
        self._robot = robot
        self._factsheet = factsheet
        self._publisher: Publisher | None = None
        self._mqtt: MqttConnection | None = None
        self._state_schedule = Schedule(
            self._publish_state, limits.min_state_interval, limits.state_interval
        )
        self._visualization_schedule = Schedule(
            self._publish_visualization, limits.visualization_interval
        )
        self._driving_state_interval = limits.driving_state_interval
        self._maps_in_state = limits.maps_in_state

    def use(self, publisher: Publisher, mqtt: MqttConnection) -> None:
        """Publish over this connection from now on."""
        self._publisher = publisher
        self._mqtt = mqtt

    def changed(self) -> None:
        """Publish the state soon."""
        self._state_schedule.changed()

    def moved(self) -> None:
        """Publish visualization soon, and the state if the last one is too old."""
        self._visualization_schedule.changed()
        if self._driving_state_interval:
            self._state_schedule.call_within(self._driving_state_interval)

    def connected(self) -> None:
        """Publish the connection, the factsheet and the state after a connection to the broker."""
        self._publish_connection(ConnectionState.ONLINE)
        self.publish_factsheet()
        self._state_schedule.changed()

    def publish_factsheet(self) -> None:
        """Publish the factsheet."""
        factsheet = self._factsheet()
        if self._publisher is not None and factsheet is not None:
            self._publish(Topic.FACTSHEET, self._publisher.version.factsheet(factsheet))

    async def close(self, timeout: float) -> None:
        """Publish OFFLINE, and nothing afterwards.

        Args:
            timeout: maximum wait for the broker, in seconds.
        """
        self._state_schedule.stop()
        self._visualization_schedule.stop()
        if self._mqtt is not None and self._mqtt.connected:
            self._publish_connection(ConnectionState.OFFLINE)
            mqtt, self._mqtt = self._mqtt, None
            await mqtt.flush(timeout)
        elif self._publisher is not None:
            self._publisher.connection_lost()

    def _publish_state(self) -> None:
        state = self._state()
        if state is not None and not self._maps_in_state:
            state = replace(state, robot=replace(state.robot, maps=None))
        if self._publisher is not None and state is not None:
            self._publish(Topic.STATE, self._publisher.version.state(state))

    def _publish_visualization(self) -> None:
        robot = self._robot()
        publisher = self._publisher
        if publisher is not None and publisher.state_id is not None and robot is not None:
            message = publisher.version.visualization(robot, publisher.state_id)
            self._publish(Topic.VISUALIZATION, message)

    def _publish_connection(self, state: ConnectionState) -> None:
        if self._publisher is not None:
            self._publish(Topic.CONNECTION, self._publisher.version.connection(state))

    def _publish(self, topic: Topic, content: dict[str, Any]) -> None:
        if self._publisher is not None and self._mqtt is not None:
            self._publisher.publish(self._mqtt, topic, content)
