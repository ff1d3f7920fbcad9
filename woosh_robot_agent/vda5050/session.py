"""A vehicle at the broker: its configuration, its session, and detection of a second connector."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.messages.state import (
    ConnectionState,
    ErrorLevel,
    ErrorType,
    VehicleError,
)
from woosh_robot_agent.vda5050.messages.versions import V2_1, Identity, Topic, Version
from woosh_robot_agent.vda5050.mqtt import BrokerConfig, MqttConnection
from woosh_robot_agent.vda5050.reports import HeaderIds, Reports
from woosh_robot_agent.vda5050.robot.link import Timing
from woosh_robot_agent.vda5050.store import Record, Store, StoreInUseError

_LOG = logging.getLogger(__name__)
_OTHER_CONNECTOR = Sentence(
    "another connector publishes as this vehicle, or connects with the same client id"
)()


class OtherConnectorDetector:
    """Detects messages on the topic `connection` that this connector did not send.

    Two connectors of a vehicle have the same client id, so the broker disconnects one when the
    other connects. When the first one connects again, it receives the other one's retained message.

    Args:
        is_own: returns True for the messages that this connector has sent.
        on_changed: called when `error` changes.
        gone_after: time without a sign of the other connector after which it counts as gone, in
            seconds; longer than the pauses between its attempts to connect.

    Attributes:
        error: error to report; None if there is no other connector.
    """

    def __init__(
        self, is_own: Callable[[bytes], bool], on_changed: Callable[[], None], gone_after: float
    ) -> None:
        self._is_own = is_own
        self._on_changed = on_changed
        self._gone_after = gone_after
        self._connections = 0
        """Number of connections to the broker so far."""
        self._timer: asyncio.TimerHandle | None = None
        """Clears the error after `gone_after`; None while no such time runs."""
        self.error: VehicleError | None = None

    def connected(self) -> None:
        """Take note of a new connection to the broker."""
        self._connections += 1
        if self.error is not None:  # the other connector may have ended meanwhile
            self._restart_timer()

    def received(self, payload: bytes, retained: bool) -> None:
        """Handle a message on the topic `connection`.

        ONLINE that this connector did not send shows another one; any other state that it did not
        send shows that the other one is gone. A retained message may be old: it shows another
        connector only after a reconnect, until `gone_after` has passed without a further sign.
        A retained OFFLINE shows none: a broker that has crashed may have restored an old one.
        """
        state = _connection_state(payload)
        if state is None or self._is_own(payload):
            return
        if retained:
            # at the first connection, it may be a message of an earlier run of this connector
            if self._connections > 1 and state != ConnectionState.OFFLINE.value:
                self._restart_timer()  # the other connector may have ended since
                self._set_error()
        elif state == ConnectionState.ONLINE.value:
            self._stop_timer()
            self._set_error()
        else:
            self._clear_error()

    def close(self) -> None:
        self._stop_timer()

    def _set_error(self) -> None:
        if self.error is None:
            hint = "end one of the two; until then the robot starts no drive"
            _LOG.error("%s; %s", _OTHER_CONNECTOR, hint)
            self.error = VehicleError(
                ErrorType.SECOND_CONNECTOR.value, ErrorLevel.FATAL, _OTHER_CONNECTOR, hint
            )
            self._on_changed()

    def _clear_error(self) -> None:
        self._stop_timer()
        if self.error is not None:
            _LOG.info("the other connector of this vehicle is gone")
            self.error = None
            self._on_changed()

    def _restart_timer(self) -> None:
        self._stop_timer()
        self._timer = asyncio.get_running_loop().call_later(self._gone_after, self._clear_error)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _connection_state(payload: bytes) -> str | None:
    """Return the connectionState of a message; None if the message has none."""
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    state = message.get("connectionState") if isinstance(message, dict) else None
    return state if isinstance(state, str) else None


_RETRY = 2.0
"""Pause between attempts to open the state file, in seconds."""
_FORBIDDEN = frozenset("+#/\0")
"""Characters that a level of a topic cannot have."""


@dataclass(frozen=True)
class VehicleConfig:
    """Configuration of a vehicle.

    Attributes:
        manufacturer: manufacturer in the topics.
        serial_number: serial number in the topics; empty for the one that the robot reports.
        interface: first level of the topics; a text with slashes gives several levels.
        state_folder: folder of the state file, and of the reports of the action logReport; None to
            keep nothing over a restart, and to lack this action.
        gone_after: time without a sign of a second connector after which it counts as gone, in
            seconds.
    """

    link: LinkConfig
    manufacturer: str = "Woosh"
    serial_number: str = ""
    interface: str = "uagv"
    version: Version = V2_1
    limits: Limits = field(default_factory=Limits)
    state_folder: Path | None = None
    timing: Timing = field(default_factory=Timing)
    gone_after: float = 40.0

    def __post_init__(self) -> None:
        """Check the levels of the topics.

        Raises:
            ValueError: a level has a character that MQTT does not permit there.
        """
        levels = {"manufacturer": self.manufacturer, "serial number": self.serial_number}
        for name, value in {**levels, "interface": self.interface.replace("/", "")}.items():
            if bad := set(value) & _FORBIDDEN:
                characters = " ".join(sorted(bad))
                raise ValueError(
                    f"the {name} is a part of the topics and cannot have {characters}: {value!r}"
                )


class Session:
    """The state file of a vehicle, and its connection to the broker.

    Create it after the first report of the robot, which may give the serial number for the topics.

    Args:
        identity: manufacturer and serial number in the topics.
        reports: messages of the vehicle, which are published over this session.
        handlers: called with the payload of each message of the master control, by topic. Topics
            that the version does not have are ignored.
        take_stops: the handler of instant actions that came while this program stood still.
        on_restored: called before connecting to the broker, with the content of the state file, and
            with an error if the file was damaged, otherwise with None.
        wait_until_able: awaited before connecting to the broker; waits until orders can be taken.
        on_changed: called after each message, and when another connector appears or disappears.
    """

    def __init__(
        self,
        config: VehicleConfig,
        broker: BrokerConfig,
        identity: Identity,
        reports: Reports,
        handlers: Mapping[Topic, Callable[[bytes], None]],
        take_stops: Callable[[bytes], None],
        on_restored: Callable[[Record, VehicleError | None], None],
        wait_until_able: Callable[[], Awaitable[None]],
        on_changed: Callable[[], None],
    ) -> None:
        self._config = config
        self._broker = broker
        self._identity = identity
        self._reports = reports
        self._handlers = handlers
        self._take_stops = take_stops
        self._on_restored = on_restored
        self._wait_until_able = wait_until_able
        self._on_changed = on_changed
        self._detector = OtherConnectorDetector(
            reports.is_own_connection, self._other_changed, config.gone_after
        )
        self._name = "-".join((config.interface, identity.manufacturer, identity.serial_number))
        """Client id at the broker, and name of the state file."""
        self._store = Store(config.state_folder, self._name)
        self._header_ids: HeaderIds | None = None
        """Header ids of the messages; None until the state file has been read."""
        self._log = LogOnce(_LOG)
        self._task: asyncio.Task[None] | None = None

    @property
    def errors(self) -> tuple[VehicleError, ...]:
        """Errors of the state file, and of a second connector."""
        errors = (self._store.error, self._detector.error)
        return tuple(error for error in errors if error is not None)

    @property
    def has_other_connector(self) -> bool:
        """True if another connector uses the topics of the vehicle."""
        return self._detector.error is not None

    @property
    def is_open(self) -> bool:
        """True once the state file has been read."""
        return self._header_ids is not None

    def start(self) -> None:
        """Open the state file, and connect to the broker."""
        self._task = asyncio.get_running_loop().create_task(self._run(), name="vda5050")
        self._task.add_done_callback(self._ended)

    def save(self, record: Record) -> None:
        """Save the state that must survive a restart: at once, or progress within some seconds."""
        if self.is_open:  # before, the record of the last run is not known
            self._store.save(record)

    async def close(self, timeout: float) -> None:
        """Publish OFFLINE, disconnect from the broker, and close the state file.

        Args:
            timeout: maximum wait for the last messages, in seconds.
        """
        await self._reports.close(timeout)
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._detector.close()
        if self._header_ids is not None:
            self._header_ids.close()
        self._store.close()

    async def _run(self) -> None:
        """Open the state file, then stay connected to the broker."""
        record, damage = await self._open()
        config = self._config
        self._header_ids = HeaderIds(record.header_ids, self._store.save_header_ids)
        self._on_restored(record, damage)
        reports = self._reports
        reports.open(self._identity, config.interface, self._header_ids)
        handlers = {
            reports.topic(topic): partial(self._handle, topic, handler)
            for topic, handler in self._handlers.items()
            if topic in config.version.received
        }
        take_stops = partial(self._handle, Topic.INSTANT_ACTIONS, self._take_stops)
        mqtt = MqttConnection(
            self._broker,
            client_id=self._name,
            last_will=reports.last_will,
            handlers={**handlers, reports.topic(Topic.CONNECTION): self._detector.received},
            late_handlers={reports.topic(Topic.INSTANT_ACTIONS): take_stops},
            on_connected=self._connected,
        )
        reports.mqtt = mqtt
        await self._wait_until_able()
        await mqtt.run()

    def _ended(self, task: asyncio.Task[None]) -> None:
        """Log an error of the program that has ended the session."""
        if not task.cancelled() and (error := task.exception()) is not None:
            _LOG.error(
                "an error of the program has taken the vehicle offline; restart the connector",
                exc_info=error,
            )

    async def _open(self) -> tuple[Record, VehicleError | None]:
        """Open the state file, and return its content, and an error if it was damaged.

        Try again until the file can be used.
        """
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

    def _handle(
        self, topic: Topic, handler: Callable[[bytes], None], payload: bytes, retained: bool
    ) -> None:
        """Pass a message to its handler; ignore a retained one, which may be of any age."""
        if retained:
            self._log.warn(
                f"retained {topic.value}",
                f"a retained message on {topic.value} was ignored; remove it from the broker, "
                "and send such messages without the retain flag",
            )
        else:
            handler(payload)
            self._on_changed()

    def _connected(self) -> None:
        self._detector.connected()
        self._reports.announce()

    def _other_changed(self) -> None:
        self._reports.announce()  # the other connector may have replaced the retained messages
        self._on_changed()
