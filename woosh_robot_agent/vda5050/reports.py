"""Publish the messages of a vehicle with their headers, e.g. the state soon after a change."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from woosh_robot_agent.vda5050.messages.factsheet import Factsheet, Limits
from woosh_robot_agent.vda5050.messages.state import ConnectionState, RobotStatus, VehicleState
from woosh_robot_agent.vda5050.messages.versions import (
    PUBLISHED,
    Identity,
    Topic,
    Version,
    timestamp,
)
from woosh_robot_agent.vda5050.messages.writing import (
    connection_message,
    factsheet_message,
    state_message,
    visualization_message,
)
from woosh_robot_agent.vda5050.mqtt import MqttConnection, Publication

_ID_COUNT = 2**32
"""Number of header ids; after the last one, they start again at 0."""
_BLOCK_SIZE = 1000
"""Number of header ids of a topic that are reserved at once."""


class HeaderIds:
    """Header ids of a vehicle, counted for each topic.

    Ids are reserved in blocks, so that no id is used again after a restart. If the program ends
    without `close`, the ids continue after the reserved block.

    Args:
        first: first id to take, by topic; 0 if missing.
        save: saves the id of each topic with which to continue after a restart; called when ids are
            reserved, before they are used, and by `close`. By default, nothing is saved.
    """

    def __init__(
        self,
        first: Mapping[str, int] | None = None,
        save: Callable[[Mapping[str, int]], None] = lambda numbers: None,
    ) -> None:
        self._next = Counter(first or {})
        self._block_ends: dict[str, int] = {}
        """The first id after the reserved block of each topic of which an id was taken."""
        self._save = save

    def next(self, topic: str) -> int:
        """Take the next id of a topic, and return it."""
        number = self._next[topic]
        self._next[topic] = following = (number + 1) % _ID_COUNT
        if self._block_ends.get(topic, following) == following:  # there is no block, or it ends
            self._block_ends[topic] = (following + _BLOCK_SIZE) % _ID_COUNT
            self._save({**self._next, **self._block_ends})
        return number

    def peek(self, topic: str) -> int:
        """Return the next id of a topic without taking it."""
        return self._next[topic]

    def close(self) -> None:
        """Save the exact ids; no id may be taken afterwards."""
        self._save(dict(self._next))


class Schedule:
    """Calls a function soon after each change, and regularly without changes.

    Args:
        shortest: minimum time from a call to the next one after a change, in seconds.
        longest: time from a call to the next one without a change, in seconds; infinite for none.
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
        """The scheduled call; None without one."""

    def changed(self) -> None:
        """Call the function as soon as the minimum time since the last call is over."""
        self.call_within(self._shortest)

    def call_within(self, interval: float) -> None:
        """Call the function once at least `interval` seconds have passed since the last call.

        If an earlier call is scheduled already, this does nothing.
        """
        loop = asyncio.get_running_loop()
        due = max(loop.time(), self._last + interval)
        if self._timer is None or self._timer.when() > due:
            self._arm(due)

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _arm(self, due: float) -> None:
        self.stop()
        self._timer = asyncio.get_running_loop().call_at(due, self._call)

    def _call(self) -> None:
        """Call the function, and schedule the next call for the case that nothing changes."""
        self._last = asyncio.get_running_loop().time()
        self._timer = None
        if self._longest < math.inf:
            self._arm(self._last + self._longest)
        self._send()


_MAX_OWN_CONNECTIONS = 64
"""Maximum number of own `connection` messages that are remembered."""


class Reports:
    """Adds headers to the messages of a vehicle, and publishes them while the broker is connected.

    Args:
        state: returns the state of the vehicle; None while it is unknown.
        robot: returns the state of the robot; None while it is unknown.
        factsheet: returns the factsheet; None while it is unknown.

    Attributes:
        mqtt: the connection to the broker; None before it is made, and once it is closed.
    """

    def __init__(
        self,
        version: Version,
        limits: Limits,
        state: Callable[[], VehicleState | None],
        robot: Callable[[], RobotStatus | None],
        factsheet: Callable[[], Factsheet | None],
    ) -> None:
        self._version = version
        self._limits = limits
        self._state = state
        self._robot = robot
        self._factsheet = factsheet
        self._identity = Identity("", "")
        self._prefix = ""
        """First levels of the topics, with a slash at the end; empty before `open`."""
        self._header_ids = HeaderIds()
        self.mqtt: MqttConnection | None = None
        self._will = Publication("", "")
        """The last will of the last attempt to connect; empty before the first."""
        self._will_id = -1
        """Header id of `_will`; -1 before the first attempt."""
        self._own_connections: deque[str] = deque(maxlen=_MAX_OWN_CONNECTIONS)
        """The last `connection` messages, and the last will that was current for each of them."""
        self._state_id: int | None = None
        """Header id of the last state; None before the first state."""
        self._state_schedule = Schedule(
            self._publish_state, limits.min_state_interval, limits.state_interval
        )
        self._visualization_schedule = Schedule(
            self._publish_visualization, limits.visualization_interval
        )

    # The vehicle at the broker

    def open(self, identity: Identity, interface: str, header_ids: HeaderIds) -> None:
        """Set the topics and the headers. Call it before `topic`, and before setting `mqtt`.

        Args:
            interface: first level of the topics.
        """
        self._identity = identity
        self._header_ids = header_ids
        major = self._version.number.split(".")[0]
        self._prefix = f"{interface}/v{major}/{identity.manufacturer}/{identity.serial_number}/"

    def topic(self, topic: Topic) -> str:
        """Return the full name of a topic."""
        return self._prefix + topic.value

    def last_will(self) -> Publication:
        """Return the message that the broker publishes when the connection breaks, and remember it.

        Its header id follows that of the first message of the connection, ONLINE.
        """
        self._skip_last_will()
        will_id = self._header_ids.peek(Topic.CONNECTION.value) + 1
        # the broker may publish the will of an attempt that failed, so it stays the same
        if will_id != self._will_id:
            content = connection_message(self._version, ConnectionState.BROKEN)
            self._will = self._message(Topic.CONNECTION, content, will_id)
            self._will_id = will_id
        return self._will

    def is_own_connection(self, payload: bytes) -> bool:
        """Return True if a `connection` message is one of this connector."""
        text = payload.decode(errors="replace")
        return text == self._will.payload or text in self._own_connections

    async def close(self, timeout: float) -> None:
        """Publish OFFLINE as the last message; without a connection, publish nothing.

        Args:
            timeout: maximum wait for the broker, in seconds.
        """
        self._state_schedule.stop()
        self._visualization_schedule.stop()
        if self.mqtt is not None and self.mqtt.connected:
            self._publish_connection(ConnectionState.OFFLINE)
            mqtt, self.mqtt = self.mqtt, None
            await mqtt.flush(timeout)
        else:
            self._skip_last_will()

    # Messages, and when they are published

    def changed(self) -> None:
        """Publish the state soon."""
        self._state_schedule.changed()

    def moved(self) -> None:
        """Publish the visualization soon, and the state if the last one is too old."""
        self._visualization_schedule.changed()
        if interval := self._limits.driving_state_interval:
            self._state_schedule.call_within(interval)

    def announce(self) -> None:
        """Publish ONLINE and the factsheet, and soon the state."""
        self._skip_last_will()  # if this is not the first ONLINE of the connection
        self._publish_connection(ConnectionState.ONLINE)
        self.publish_factsheet()
        self.changed()

    def publish_factsheet(self) -> None:
        if (factsheet := self._factsheet()) is not None:
            self._publish(Topic.FACTSHEET, factsheet_message(self._version, factsheet))

    def _publish_state(self) -> None:
        """Publish the state now, unless it is unknown."""
        if (state := self._state()) is not None:
            if not self._limits.maps_in_state:
                state = replace(state, robot=replace(state.robot, maps=None))
            self._publish(Topic.STATE, state_message(self._version, state))

    def _publish_visualization(self) -> None:
        """Publish the visualization now, but not before the first state, to which it refers."""
        robot = self._robot()
        if self._state_id is not None and robot is not None:
            message = visualization_message(self._version, robot, self._state_id)
            self._publish(Topic.VISUALIZATION, message)

    def _publish_connection(self, state: ConnectionState) -> None:
        self._publish(Topic.CONNECTION, connection_message(self._version, state))

    def _publish(self, topic: Topic, content: Mapping[str, Any]) -> None:
        """Publish a message with its header; do nothing without a connection."""
        if self.mqtt is None or not self.mqtt.connected:
            return
        publication = self._message(topic, content)
        if topic is Topic.CONNECTION:  # remembered, because the broker sends it back
            self._own_connections += (self._will.payload, publication.payload)
        self.mqtt.publish(publication)

    def _message(
        self, topic: Topic, content: Mapping[str, Any], header_id: int | None = None
    ) -> Publication:
        """Return a message with its header; without `header_id`, with the next id of the topic."""
        if header_id is None:
            header_id = self._header_ids.next(topic.value)
        head = {
            "headerId": header_id,
            "timestamp": timestamp(time.time()),
            "version": self._version.number,
            "manufacturer": self._identity.manufacturer,
            "serialNumber": self._identity.serial_number,
        }
        if topic is Topic.STATE:
            self._state_id = header_id
        payload = json.dumps(head | dict(content), separators=(",", ":"), allow_nan=False)
        return Publication(self.topic(topic), payload, *PUBLISHED[topic])

    def _skip_last_will(self) -> None:
        """Skip the header id of the last will: the broker may have published it, or still will."""
        if self._header_ids.peek(Topic.CONNECTION.value) == self._will_id:
            self._header_ids.next(Topic.CONNECTION.value)
