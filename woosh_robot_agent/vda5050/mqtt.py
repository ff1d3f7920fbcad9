"""The connection to the MQTT broker, and its options."""

from __future__ import annotations

import argparse
import asyncio
import logging
import math
import os
import re
import ssl
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

import aiomqtt

from woosh_robot_agent.link.reconnect import Backoff
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion.timeliness import boot_time

_LOG = logging.getLogger(__name__)
_LIBRARY_LOG = logging.getLogger(f"{__name__}.library")
"""Log of the MQTT libraries; silenced, because they report a lost connection several times and
without a hint."""
_LIBRARY_LOG.setLevel(logging.CRITICAL)
_DEFAULT_PORTS = {"mqtt": 1883, "mqtts": 8883}
_BACKOFF_MIN = 0.5
"""First pause between attempts to connect, in seconds; it doubles with each attempt."""
_STABLE_AFTER = 5.0
"""Duration after which a connection counts as stable, in seconds."""
_MAX_OUTBOX = 1000
"""Maximum number of messages that wait to be sent; the oldest ones are dropped."""
MAX_RECEIVED = 200
"""Maximum number of messages of one topic that wait to be handled; new ones are dropped."""
_MAX_RECEIVED_SIZE = 16 * 2**20
"""Maximum size of all messages of one topic that wait to be handled, in bytes. A larger
message is received if no other one waits."""
_DRAIN = 1.0
"""Maximum time to read what came before the connection ends, in seconds."""
_REFUSED = 0x80
"""Lowest result code of a subscription that the broker has refused."""
_HINTS = (
    (
        ssl.SSLCertVerificationError,
        "check the host name, and that the certificate of the broker's authority is trusted here",
    ),
    (ssl.SSLError, "check that the broker speaks TLS on this port"),
    (ConnectionRefusedError, "check that the broker runs, and listens on this port"),
    (ConnectionResetError, "check that this is the broker's port for mqtt:// or mqtts://"),
)
"""Types of errors, and hints what to do; the first type that matches is used."""
_LOGIN_REFUSED = frozenset({4, 5, 134, 135})
"""Reason codes of MQTT 3.1.1 and 5 for a wrong user name or password, or a missing right."""


class LoginFileError(ValueError):
    """A file of the login at the broker cannot be used; the text says why."""


@dataclass(frozen=True)
class BrokerConfig:
    """Address of the broker, and how to log in.

    The files may be renewed while the program runs: each attempt to connect reads them again.

    Attributes:
        tls: True for a connection with TLS.
        username: user name; None for a login without a name.
        password: password; None for a login without a password.
        password_file: file with the password in its first line; None for `password`.
        ca_file: certificates of the authorities that are trusted; None for those of the system.
        cert_file: client certificate; None for a login without one.
        key_file: its key; None if it is in `cert_file`.
        keepalive: interval of the MQTT keep-alive, in seconds. The broker publishes the last will
            if nothing arrives for 1.5 times as long.
        backoff_max: longest pause between attempts to connect, in seconds.
    """

    host: str
    port: int
    tls: bool = False
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    password_file: Path | None = None
    ca_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None
    keepalive: int = 15
    backoff_max: float = 15.0

    @classmethod
    def from_url(cls, url: str) -> BrokerConfig:
        """Return the configuration for a URL such as `mqtt://user:password@host:1883`.

        Raises:
            ValueError: the URL is not valid; the text gives the reason.
        """
        parts = urlsplit(url)
        shown = re.sub("//.*@", "//...@", url)  # a password must not get into a log
        if parts.scheme not in _DEFAULT_PORTS:
            raise ValueError(f"the URL of a broker begins with mqtt:// or mqtts://: {shown!r}")
        if not parts.hostname or parts.path.strip("/") or parts.query or parts.fragment:
            raise ValueError(f"the URL of a broker has the form mqtt://HOST:PORT: {shown!r}")
        return cls(
            host=parts.hostname,
            port=parts.port or _DEFAULT_PORTS[parts.scheme],
            tls=parts.scheme == "mqtts",
            username=None if parts.username is None else unquote(parts.username),
            password=None if parts.password is None else unquote(parts.password),
        )

    def read_password(self) -> str | None:
        """Return the password; None without one.

        Raises:
            LoginFileError: its file cannot be read, or has no password.
        """
        path = self.password_file
        if path is None:
            return self.password
        try:
            lines = path.read_text("utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise LoginFileError(
                f"cannot read the password from {path}: {_reason(error)}"
            ) from None
        if not lines or not lines[0]:
            raise LoginFileError(f"there is no password in the first line of {path}")
        return lines[0]

    def tls_context(self) -> ssl.SSLContext | None:
        """Return the TLS settings; None for a connection without TLS.

        Raises:
            LoginFileError: a file cannot be used.
        """
        if not self.tls:
            return None
        files = (self.ca_file, self.cert_file, self.key_file)
        return _tls(*files, tuple(map(_modified, files)))


class Publication(NamedTuple):
    """A message to publish.

    Attributes:
        qos: QoS level.
        retain: True if the broker keeps the message for new subscribers.
    """

    topic: str
    payload: str
    qos: int = 0
    retain: bool = False


class MqttConnection:
    """A connection to a broker that reconnects by itself. Used in one asyncio event loop.

    Messages that are published without a connection are dropped, not queued.

    Args:
        broker: address of the broker, and how to log in.
        client_id: id of the client; unique at the broker.
        last_will: returns the message that the broker publishes when the connection breaks.
        handlers: functions by topic, called with the payload of each message and its retain flag.
        late_handlers: the same for messages that came while this program stood still; messages on
            other topics are ignored then.
        on_connected: called after each connection, once messages can be published.

    Attributes:
        connected: True while messages can be published.
    """

    def __init__(
        self,
        broker: BrokerConfig,
        client_id: str,
        last_will: Callable[[], Publication],
        handlers: Mapping[str, Callable[[bytes, bool], None]],
        late_handlers: Mapping[str, Callable[[bytes, bool], None]],
        on_connected: Callable[[], None],
    ) -> None:
        self._broker = broker
        self._client_id = client_id
        self._last_will = last_will
        self._handlers = handlers
        self._late_handlers = late_handlers
        self._on_connected = on_connected
        self._log = LogOnce(_LOG)
        self._outbox: asyncio.Queue[Publication] = asyncio.Queue()
        self.connected = False
        self._connected_at = math.inf
        """Loop time at which the connection of the last attempt began; infinite without one."""
        self._awake_at = math.inf
        """Last time, by `boot_time`, at which this program was awake during the connection."""

    def publish(self, publication: Publication) -> None:
        """Queue a message for publication; drop it if there is no connection."""
        if self.connected:
            if self._outbox.qsize() >= _MAX_OUTBOX:
                self._outbox.get_nowait()
                self._outbox.task_done()
            self._outbox.put_nowait(publication)

    async def flush(self, timeout: float) -> None:
        """Wait until everything is published, at most `timeout` seconds."""
        try:
            await run_with_timeout(timeout, self._outbox.join())
        except TimeoutError:
            _LOG.warning("the broker did not take the last messages within %g s", timeout)

    async def run(self) -> None:
        """Stay connected until cancelled."""
        backoff = Backoff(_BACKOFF_MIN, self._broker.backoff_max)
        clock = asyncio.get_running_loop().time
        while True:
            self._connected_at = math.inf
            try:
                await self._serve_connection()
                reason = "the broker closed it"
            except (aiomqtt.MqttError, OSError, LoginFileError) as error:
                reason = _explained(error)
            except Exception as error:  # the loop must survive whatever a library raises
                _LOG.debug("the connection to the broker failed", exc_info=True)
                reason = f"internal error: {error!r}"
            finally:
                self.connected = False
            if clock() - self._connected_at >= _STABLE_AFTER:
                backoff.reset()
                self._log.clear()
            self._log.warn(
                reason,
                f"no connection to the broker at {self._broker.host}:{self._broker.port}: {reason}",
            )
            await asyncio.sleep(backoff.next())

    async def _serve_connection(self) -> None:
        """Connect, and serve the connection until it ends.

        Raises:
            MqttError: the connection failed.
            LoginFileError: a file of the login cannot be used.
        """
        broker = self._broker
        async with _Client(
            broker.host,
            broker.port,
            username=broker.username,
            password=broker.read_password(),
            identifier=self._client_id,
            will=aiomqtt.Will(*self._last_will()),
            clean_session=True,
            keepalive=broker.keepalive,
            tls_context=broker.tls_context(),
            logger=_LIBRARY_LOG,
            queue_type=ReceiveQueue,
        ) as client:
            granted = await client.subscribe([(topic, 0) for topic in self._handlers])
            if refused := refused_topics(self._handlers, granted):
                self._log.warn(
                    "subscription",
                    f"the broker refused the subscription to {', '.join(refused)}; give the "
                    "vehicle the right to read there",
                )
            self._outbox = asyncio.Queue()
            self.connected = True
            self._connected_at = asyncio.get_running_loop().time()
            self._awake_at = boot_time()
            _LOG.info("connected to the broker at %s:%d", broker.host, broker.port)
            self._on_connected()
            reader = asyncio.create_task(self._read(client), name="mqtt reader")
            work = [
                reader,
                asyncio.create_task(self._send(client), name="mqtt sender"),
                asyncio.create_task(self._watch_for_stalls(), name="mqtt stall watch"),
            ]
            try:
                done, _ = await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
                # the reader ends when it has handled all that came, e.g. a pause
                await asyncio.wait({reader}, timeout=_DRAIN)
                for each in done:
                    each.result()  # raises the exception of the task
            finally:
                for each in work:
                    each.cancel()
                await asyncio.gather(*work, return_exceptions=True)

    async def _read(self, client: aiomqtt.Client) -> None:
        """Handle messages until the connection ends.

        Raises:
            MqttError: the connection is lost.
        """
        async for message in client.messages:
            self._handle(message, self._handlers if self._was_awake() else self._late_handlers)
            await asyncio.sleep(0)  # a flood of messages must not stop everything else

    async def _watch_for_stalls(self) -> None:
        """Check once per second, also without messages, that this program has not stood still.

        Raises:
            MqttError: it stood still.
        """
        while self._was_awake():
            await asyncio.sleep(1.0)
        raise aiomqtt.MqttError(
            "this program stood still; of what came meanwhile, only stops count"
        )

    def _was_awake(self) -> bool:
        """Return False if this program has stood still, e.g. suspended, during the connection.

        Then the broker may have published the last will, and the messages that still come over the
        connection are old: a drive that they order may not be wanted any more.
        """
        now = boot_time()
        # The broker waits for 1.5 keep-alive intervals. One may be over when the standstill begins,
        # so half an interval is left; a third is safe.
        if now - self._awake_at > self._broker.keepalive / 3:
            self._awake_at = -math.inf  # until the next connection
            return False
        self._awake_at = now
        return True

    def _handle(
        self, message: aiomqtt.Message, handlers: Mapping[str, Callable[[bytes, bool], None]]
    ) -> None:
        """Pass a message to the handler of its topic; log an exception of the handler."""
        topic = message.topic.value
        handler = handlers.get(topic)
        if handler is None or not isinstance(message.payload, bytes | bytearray):
            return
        if not message.payload:  # somebody has removed a retained message from the broker
            return
        try:
            handler(bytes(message.payload), message.retain)
        except Exception:  # a message must not end the connection
            _LOG.exception(
                "an error of the program prevented the handling of a message on %s", topic
            )

    async def _send(self, client: aiomqtt.Client) -> None:
        """Publish the messages in the outbox."""
        while True:
            await client.publish(*await self._outbox.get())
            self._outbox.task_done()


class _Client(aiomqtt.Client):
    """The client of aiomqtt, with workarounds for four bugs of its release 2.5.1.

    1. The exception of a lost connection is set on a future that may never be awaited. asyncio then
       logs a traceback (`__init__`).
    2. If the task is cancelled while it connects, the connection stays open (`__aenter__`,
       `_on_disconnect`).
    3. If the broker does not take the DISCONNECT, an MqttError replaces the cancellation or error
       that ended the block (`__aexit__`).
    4. A socket that was closed meanwhile is watched. asyncio then logs a traceback
       (`_on_socket_register_write`).
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        # otherwise asyncio logs the exception as never retrieved; the calls that fail raise it too
        self._disconnected.add_done_callback(
            lambda future: future.cancelled() or future.exception()
        )

    async def __aenter__(self) -> Any:
        try:
            return await super().__aenter__()
        except BaseException:
            self._client.disconnect()
            raise

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.timeout = min(self.timeout, _DRAIN)  # of the DISCONNECT, for which nobody waits
        try:
            await super().__aexit__(kind, error, traceback)
        except aiomqtt.MqttError:
            if error is None:
                raise  # otherwise the error or cancellation inside the block counts

    def _on_disconnect(self, *args: Any, **kwargs: Any) -> None:
        if not self._connected.cancelled():  # aiomqtt calls its `exception`, which would raise
            super()._on_disconnect(*args, **kwargs)

    def _on_socket_register_write(self, client: Any, userdata: Any, sock: Any) -> None:
        """Write to the socket when it is writable; called in any thread."""

        def write() -> None:
            try:
                client.loop_write()
            except Exception as error:  # as in aiomqtt: whatever it is, the connection is lost
                if not self._disconnected.done():
                    self._disconnected.set_exception(error)

        def watch() -> None:
            if (descriptor := sock.fileno()) >= 0:
                self._loop.add_writer(descriptor, write)

        self._loop.call_soon_threadsafe(watch)


class ReceiveQueue(asyncio.Queue[aiomqtt.Message]):
    """Queue of received messages; drops a new one if those of its topic are too many or too large.

    Each topic has its own limits, so that a flood of orders does not take the place of a pause.
    """

    def __init__(self, maxsize: int = 0) -> None:
        super().__init__(maxsize)
        self._counts = Counter[str]()
        """Number of messages, by topic."""
        self._sizes = Counter[str]()
        """Length of all payloads, in bytes, by topic."""
        self._log = LogOnce(_LOG)

    def put_nowait(self, item: aiomqtt.Message) -> None:
        topic, length = item.topic.value, _length(item)
        size = self._sizes[topic]
        is_too_large = size > 0 and size + length > _MAX_RECEIVED_SIZE
        if self._counts[topic] >= MAX_RECEIVED or is_too_large:
            self._log.warn(
                topic,
                f"messages on {topic} come faster than they can be handled, and some were dropped",
            )
            return
        self._counts[topic] += 1
        self._sizes[topic] += length
        super().put_nowait(item)

    def get_nowait(self) -> aiomqtt.Message:
        item = super().get_nowait()
        topic = item.topic.value
        self._counts[topic] -= 1
        self._sizes[topic] -= _length(item)
        if not self._counts[topic]:
            self._log.clear(topic)
        return item


def refused_topics(topics: Iterable[str], granted: Iterable[Any]) -> list[str]:
    """Return the topics that the broker does not let the vehicle read.

    Args:
        topics: the topics of the subscription.
        granted: result code for each topic, in the same order; an integer, or an object of the MQTT
            library with the integer as its `value`.
    """
    codes = (getattr(each, "value", each) for each in granted)
    return [topic for topic, code in zip(topics, codes, strict=False) if code >= _REFUSED]


def _length(message: aiomqtt.Message) -> int:
    return len(message.payload) if isinstance(message.payload, bytes | bytearray) else 0


def _explained(error: Exception) -> str:
    """Return the reason of a failed connection, and what to do."""
    # aiomqtt raises an MqttError while it handles the original error
    cause = error.__context__ if isinstance(error, aiomqtt.MqttError) else error
    hint = next((hint for kind, hint in _HINTS if isinstance(cause, kind)), "")
    code = error.rc if isinstance(error, aiomqtt.MqttCodeError) else None
    if getattr(code, "value", code) in _LOGIN_REFUSED:
        hint = "check the user name and the password, and that the broker permits them"
    return f"{error}; {hint}" if hint else str(error)


_PASSWORD_VARIABLE = "VDA5050_PASSWORD"
"""Environment variable with the password."""


def add_broker_options(parser: argparse.ArgumentParser) -> None:
    """Add `--broker` and the other options of the broker to a parser."""
    group = parser.add_argument_group("broker")
    group.add_argument(
        "--broker",
        required=True,
        metavar="URL",
        help="URL of the broker, e.g. mqtt://192.168.0.2:1883, or mqtts://broker.example for TLS",
    )
    group.add_argument("--username", help="user name at the broker")
    group.add_argument(
        "--password-file",
        type=Path,
        metavar="FILE",
        help="file with the password, in its first line; without it, the environment variable "
        f"{_PASSWORD_VARIABLE} is used. A password in the URL can be seen by all users of this "
        "machine",
    )
    group.add_argument(
        "--ca-file",
        type=Path,
        metavar="FILE",
        help="certificates that are trusted to sign the certificate of the broker, in PEM "
        "(default: the certificates of the system)",
    )
    group.add_argument("--cert-file", type=Path, metavar="FILE", help="client certificate, in PEM")
    group.add_argument(
        "--key-file",
        type=Path,
        metavar="FILE",
        help="private key of the client certificate, in PEM and not encrypted (default: in "
        "--cert-file)",
    )


def broker_config(
    options: argparse.Namespace, environment: Mapping[str, str] = os.environ
) -> BrokerConfig:
    """Return the configuration of the connection to the broker.

    Raises:
        ValueError: an option is invalid; the text gives the reason.
    """
    broker = replace(
        BrokerConfig.from_url(options.broker),
        password_file=options.password_file,
        ca_file=options.ca_file,
        cert_file=options.cert_file,
        key_file=options.key_file,
    )
    if options.username is not None:
        broker = replace(broker, username=options.username)
    if password := environment.get(_PASSWORD_VARIABLE):
        broker = replace(broker, password=password)
    password = broker.read_password()
    if password is not None and broker.username is None:
        raise ValueError("a password needs a user name: --username NAME")
    if broker.password_file is not None and not broker.password_file.is_file():
        # e.g. a pipe, which can be read only once
        broker = replace(broker, password=password, password_file=None)
    files = {
        "--ca-file": options.ca_file,
        "--cert-file": options.cert_file,
        "--key-file": options.key_file,
    }
    given = [name for name, path in files.items() if path is not None]
    if given and not broker.tls:
        raise ValueError(f"{given[0]} needs TLS: begin the URL of the broker with mqtts://")
    if options.key_file is not None and options.cert_file is None:
        raise ValueError("--key-file needs --cert-file")
    broker.tls_context()
    return broker


def _modified(path: Path | None) -> int:
    """Return the time at which a file was changed, in ns; 0 without a file that can be read."""
    try:
        return path.stat().st_mtime_ns if path else 0
    except OSError:
        return 0


@lru_cache(maxsize=1)
def _tls(
    ca_file: Path | None, cert_file: Path | None, key_file: Path | None, _versions: tuple[int, ...]
) -> ssl.SSLContext:
    """Return TLS settings with the given files; without `ca_file`, the system's authorities count.

    To load the authorities takes up to 0.3 s, in which no vehicle does anything. So the settings
    are kept until a file has changed, and a client certificate that cannot be used fails before.

    Raises:
        LoginFileError: a file cannot be used.
    """

    def no_password() -> str:
        raise LoginFileError(
            "the private key is encrypted; decrypt it, and protect its file instead"
        )

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # checks the certificate and the host name
    if cert_file is not None:
        try:
            context.load_cert_chain(cert_file, key_file, password=no_password)
        except OSError as error:
            raise LoginFileError(
                f"cannot use the certificate in {cert_file} with the key in "
                f"{key_file or cert_file}: {_reason(error)}"
            ) from None
    if ca_file is None:
        context.load_default_certs()
        return context
    try:
        context.load_verify_locations(ca_file)
    except OSError as error:
        raise LoginFileError(
            f"cannot use the certificates in {ca_file}: {_reason(error)}"
        ) from None
    return context


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
