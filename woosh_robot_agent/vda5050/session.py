"""A vehicle under one identity: its connection to the broker, and its state file."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.link.robot_identity import RobotIdentity
from woosh_robot_agent.vda5050.model.errors import VehicleError
from woosh_robot_agent.vda5050.mqtt import BrokerConfig, MqttConnection
from woosh_robot_agent.vda5050.other_connector import OtherConnector
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.header import HeaderIds, Identity
from woosh_robot_agent.vda5050.protocol.topics import Topic
from woosh_robot_agent.vda5050.publisher import Publisher
from woosh_robot_agent.vda5050.reports import Reports
from woosh_robot_agent.vda5050.store import Record, Store, StoreInUseError

_LOG = logging.getLogger(__name__)
_RETRY = 2.0
"""Pause between attempts to open the state file, in seconds."""
_SAVE_WITHIN = 2.0
"""Maximum delay before the progress of the order and of instant actions is saved, in seconds."""


@dataclass(frozen=True)
class SessionConfig:
    """Identity of a vehicle at the broker, and folder of its state file.

    Attributes:
        broker: address of the broker.
        version: version of the standard.
        identity: manufacturer and serial number.
        interface: first level of the topics.
        state_folder: folder of the state file; None for no state file.
    """

    broker: BrokerConfig
    version: Version
    identity: Identity
    interface: str
    state_folder: Path | None


class Session:
    """A vehicle at the broker, from the first report of its robot until another robot answers.

    Args:
        config: configuration.
        robot: identity of the robot.
        reports: messages of the vehicle; published over this session from now on.
        handlers: called with the payload of each message of the master control, by topic. Topics
            that the version does not have are left out.
        on_opened: called with the content of the state file before connecting to the broker, and
            with an error if the file was damaged.
        on_changed: called when an error begins or ends.

    Attributes:
        identity: manufacturer and serial number of the vehicle.
        robot: identity of the robot.
    """

    def __init__(
        self,
        config: SessionConfig,
        robot: RobotIdentity,
        reports: Reports,
        handlers: Mapping[Topic, Callable[[bytes], None]],
        on_opened: Callable[[Record, VehicleError | None], None],
        on_changed: Callable[[], None],
    ) -> None:
        self.identity = config.identity
        self.robot = robot
        self._config = config
        self._reports = reports
        self._handlers = handlers
        self._on_opened = on_opened
        self._on_changed = on_changed
        self._name = "-".join(
            (config.interface, self.identity.manufacturer, self.identity.serial_number)
        )
        self._store = Store(config.state_folder, self._name)
        self._header_ids: HeaderIds | None = None
        """None until the state file has been read."""
        self._other: OtherConnector | None = None
        self._late: asyncio.TimerHandle | None = None
        """Saves `_record` later; None if it has been saved."""
        self._record = Record()
        """Record to save."""
        self._log = LogOnce(_LOG)
        self._task: asyncio.Task[None] | None = None

    @property
    def errors(self) -> tuple[VehicleError, ...]:
        """Errors of the session."""
        other = None if self._other is None else self._other.error
        return tuple(error for error in (self._store.error, other) if error is not None)

    @property
    def has_other_connector(self) -> bool:
        """True if another connector uses the topics of the vehicle."""
        return self._other is not None and self._other.error is not None

    @property
    def is_open(self) -> bool:
        """True once the state file has been read."""
        return self._header_ids is not None

    def start(self, former: asyncio.Task[None] | None = None) -> None:
        """Open the state file, and connect to the broker.

        Args:
            former: task that closes the former session; it is awaited first.
        """
        self._task = asyncio.get_running_loop().create_task(self._run(former), name="vda5050")
        self._task.add_done_callback(self._ended)

    def save(self, record: Record) -> None:
        """Save the state that must survive a restart.

        What keeps something from being done twice is on the disk on return, the rest soon.
        """
        if not self.is_open:
            return
        self._record = record
        if not self._store.can_wait(record):
            self._save()
        elif self._late is None:  # each file takes milliseconds, in which nothing else happens
            self._late = asyncio.get_running_loop().call_later(_SAVE_WITHIN, self._save)

    async def close(self, timeout: float) -> None:
        """Publish that the vehicle is offline, and disconnect from the broker.

        Args:
            timeout: maximum wait for the last messages, in seconds.
        """
        await self._reports.close(timeout)
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        if self._other is not None:
            self._other.close()
        if self._late is not None:
            self._save()
        if self._header_ids is not None:
            self._header_ids.close()
        self._store.close()

    def _save(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None
        self._store.save(self._record)

    async def _run(self, former: asyncio.Task[None] | None) -> None:
        if former is not None:
            await asyncio.wait({former})
        record, damage = await self._open()
        config = self._config
        self._header_ids = HeaderIds(record.header_ids, self._store.save_header_ids)
        self._on_opened(record, damage)
        publisher = Publisher(config.version, self.identity, config.interface, self._header_ids)
        self._other = OtherConnector(publisher.is_own_connection, self._other_changed)
        handlers = {
            publisher.topic(topic): self._ignoring_retained(topic, handler)
            for topic, handler in self._handlers.items()
            if topic in config.version.received
        }
        mqtt = MqttConnection(
            config.broker,
            client_id=self._name,
            last_will=publisher.last_will,
            handlers={**handlers, publisher.topic(Topic.CONNECTION): self._other.received},
            on_connected=self._connected,
        )
        self._reports.use(publisher, mqtt)
        await mqtt.run()

    def _ended(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            _LOG.error(
                "an error of the program has taken the vehicle offline; restart the connector",
                exc_info=error,
            )

    async def _open(self) -> tuple[Record, VehicleError | None]:
        while True:
            try:
                return self._store.open()
            except StoreInUseError as error:
                self._log.warn("in use", f"the vehicle stays offline: {error}")
            except OSError as error:
                self._log.warn(
                    str(error),
                    f"the vehicle stays offline, because its state file cannot be used; correct "
                    f"that, or choose another --state-folder: {error}",
                )
            await asyncio.sleep(_RETRY)

    def _ignoring_retained(
        self, topic: Topic, handler: Callable[[bytes], None]
    ) -> Callable[[bytes, bool], None]:
        """Return a handler that ignores retained messages, which may be of any age."""

        def handle(payload: bytes, retained: bool) -> None:
            if retained:
                self._log.warn(
                    f"retained {topic.value}",
                    f"a retained message on {topic.value} was ignored; remove it from the broker, "
                    "and send such messages without the retain flag",
                )
            else:
                handler(payload)

        return handle

    def _connected(self) -> None:
        if self._other is not None:
            self._other.connected()
        self._reports.connected()

    def _other_changed(self) -> None:
        self._reports.connected()  # the other connector may have published another state
        self._on_changed()
