"""Messages of a vehicle to the master control, and the times of their publication."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from woosh_robot_agent.vda5050.model.factsheet import Factsheet
from woosh_robot_agent.vda5050.model.state import ConnectionState, RobotStatus, VehicleState
from woosh_robot_agent.vda5050.mqtt import MqttConnection
from woosh_robot_agent.vda5050.protocol.topics import Topic
from woosh_robot_agent.vda5050.publisher import Publisher
from woosh_robot_agent.vda5050.robot.factsheet import Limits
from woosh_robot_agent.vda5050.schedule import Schedule


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
