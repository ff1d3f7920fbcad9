"""The connection to the MQTT broker."""

from __future__ import annotations

import asyncio
import logging
import ssl
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

import aiomqtt

from woosh_robot_agent.link.backoff import Backoff
from woosh_robot_agent.link.log_once import LogOnce

_LOG = logging.getLogger(__name__)
_PORTS = {"mqtt": 1883, "mqtts": 8883}
_BACKOFF_MIN = 0.5
"""First pause between attempts to connect, in seconds; it doubles with each attempt."""
_BACKOFF_MAX = 15.0
"""Longest pause between attempts to connect, in seconds."""
_MAX_OUTBOX = 1000
"""Maximum number of messages that wait to be sent; the oldest ones are dropped."""


@dataclass(frozen=True)
class BrokerConfig:
    """Address of the broker, and how to log in.

    Attributes:
        host: address or host name.
        port: port.
        tls: TLS settings; None for a connection without TLS.
        username: user name; None without one.
        password: password; None without one.
        keepalive: interval of the MQTT keep-alive, in seconds. The broker publishes the last will
            if nothing arrives for 1.5 times as long.
    """

    host: str
    port: int
    tls: ssl.SSLContext | None = field(default=None, repr=False, compare=False)
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    keepalive: int = 15

    @classmethod
    def from_url(cls, url: str) -> BrokerConfig:
        """Return the configuration for a URL such as `mqtt://user:password@host:1883`.

        Raises:
            ValueError: the URL is not valid; the text gives the reason.
        """
        parts = urlsplit(url)
        if parts.scheme not in _PORTS:
            raise ValueError(f"the URL of a broker begins with mqtt:// or mqtts://: {url!r}")
        if not parts.hostname or parts.path.strip("/") or parts.query:
            raise ValueError(f"the URL of a broker has the form mqtt://HOST:PORT: {url!r}")
        return cls(
            host=parts.hostname,
            port=parts.port or _PORTS[parts.scheme],
            tls=ssl.create_default_context() if parts.scheme == "mqtts" else None,
            username=None if parts.username is None else unquote(parts.username),
            password=None if parts.password is None else unquote(parts.password),
        )


class Publication(NamedTuple):
    """A message to publish.

    Attributes:
        topic: full topic.
        payload: content.
        qos: QoS level.
        retain: the broker keeps it for new subscribers.
    """

    topic: str
    payload: str
    qos: int = 0
    retain: bool = False


class MqttConnection:
    """A connection to a broker that reconnects by itself. Used in one asyncio event loop.

    Nothing is kept while the broker is lost: what is published then is dropped.

    Args:
        broker: address of the broker.
        client_id: id of the client; unique at the broker.
        last_will: returns the message that the broker publishes when the connection breaks.
        handlers: called with the payload of each message, by topic.
        on_connected: called after each connection, when messages can be published.
    """

    def __init__(
        self,
        broker: BrokerConfig,
        client_id: str,
        last_will: Callable[[], Publication],
        handlers: Mapping[str, Callable[[bytes], None]],
        on_connected: Callable[[], None],
    ) -> None:
        self._broker = broker
        self._client_id = client_id
        self._last_will = last_will
        self._handlers = handlers
        self._on_connected = on_connected
        self._log = LogOnce(_LOG)
        self._outbox: deque[Publication] = deque(maxlen=_MAX_OUTBOX)
        self._wake = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()
        self.connected = False
        """True while messages can be published."""

    def publish(self, publication: Publication) -> None:
        """Publish a message, after those before it; drop it if there is no connection."""
        if self.connected:
            self._outbox.append(publication)
            self._idle.clear()
            self._wake.set()

    async def flush(self, timeout: float) -> None:
        """Wait until everything is published, at most `timeout` seconds."""
        try:
            await asyncio.wait_for(self._idle.wait(), timeout)
        except asyncio.TimeoutError:
            _LOG.warning("the broker did not take the last messages in time")

    async def run(self) -> None:
        """Stay connected until cancelled."""
        backoff = Backoff(_BACKOFF_MIN, _BACKOFF_MAX)
        while True:
            try:
                await self._connect()
            except (aiomqtt.MqttError, OSError) as error:
                if self.connected:
                    backoff.reset()
                self._log.warn(
                    "lost",
                    f"no connection to the broker at {self._broker.host}:{self._broker.port}: "
                    f"{error}",
                )
            finally:
                self.connected = False
            await asyncio.sleep(backoff.next())

    async def _connect(self) -> None:
        """Serve one connection until it breaks.

        Raises:
            MqttError: the connection failed.
        """
        will = self._last_will()
        broker = self._broker
        async with aiomqtt.Client(
            broker.host,
            broker.port,
            username=broker.username,
            password=broker.password,
            identifier=self._client_id,
            will=aiomqtt.Will(will.topic, will.payload, will.qos, will.retain),
            clean_session=True,
            keepalive=broker.keepalive,
            tls_context=broker.tls,
        ) as client:
            await client.subscribe([(topic, 0) for topic in self._handlers])
            self._outbox.clear()
            self.connected = True
            _LOG.info("connected to the broker at %s:%d", broker.host, broker.port)
            self._log.clear()
            self._on_connected()
            sender = asyncio.create_task(self._send(client), name="mqtt sender")
            try:
                async for message in client.messages:
                    self._handle(message)
            finally:
                sender.cancel()
                await asyncio.gather(sender, return_exceptions=True)

    def _handle(self, message: aiomqtt.Message) -> None:
        handler = self._handlers.get(message.topic.value)
        if handler is not None and isinstance(message.payload, bytes | bytearray):
            handler(bytes(message.payload))

    async def _send(self, client: aiomqtt.Client) -> None:
        """Publish what is in the outbox; the reader notices a broken connection."""
        while True:
            while self._outbox:
                publication = self._outbox.popleft()
                await client.publish(*publication)
            self._idle.set()
            self._wake.clear()
            await self._wake.wait()
