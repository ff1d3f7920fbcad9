"""A real MQTT broker, and a record of all that goes through it."""

from __future__ import annotations

import contextlib
import json
import random
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho

from woosh_robot_agent.vda5050.messages.reading import defect

VERSIONS = {"v2": "2.1.0", "v3": "3.0.0"}
_TIMEOUT = 60.0
_END = "test/end"


def mosquitto_path() -> str | None:
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


def free_port() -> int:
    """Return a free port below those that the system gives to clients, who might take it."""
    while True:
        port = random.randrange(20_000, 32_000)
        with socket.socket() as sock, contextlib.suppress(OSError):
            sock.bind(("127.0.0.1", port))
            return port


class Mosquitto:
    """A mosquitto on a port of its own, in a block. It can be stopped and started again."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self._folder = folder

    def __enter__(self) -> Mosquitto:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    def settings(self) -> str:
        return f"listener {self.port} 127.0.0.1\nallow_anonymous true\nuser root\n"

    def start(self) -> None:
        config = self._folder / f"mosquitto-{self.port}.conf"
        config.write_text(self.settings())
        path = mosquitto_path()
        assert path, "mosquitto is not installed; scripts/test installs it"
        with config.with_suffix(".log").open("ab") as log:
            self._process = subprocess.Popen([path, "-v", "-c", config], stderr=log, stdout=log)
        for _ in range(int(_TIMEOUT / 0.02)):
            with contextlib.suppress(OSError):
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
                return
            assert self._process.poll() is None, "mosquitto has ended; see its log"
            time.sleep(0.02)
        raise AssertionError("mosquitto does not listen")

    def stop(self) -> None:
        self._process.kill()
        self._process.wait()

    @contextlib.contextmanager
    def frozen(self) -> Iterator[None]:
        """Let the broker stand still in a block: its connections stay open."""
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)


class Recorder:
    """Records all messages at a broker, with a client that neither side uses."""

    def __init__(self, port: int) -> None:
        self.messages: list[tuple[str, bytes]] = []
        self._subscribed = threading.Event()
        self._ended = threading.Event()
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe("#", 1)
        self._client.on_subscribe = lambda *_: self._subscribed.set()
        self._client.on_message = self._received
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert self._subscribed.wait(_TIMEOUT)

    def _received(self, client: paho.Client, data: Any, message: paho.MQTTMessage) -> None:
        if message.topic == _END:
            self._ended.set()
        else:
            self.messages.append((message.topic, message.payload))

    def catch_up(self) -> None:
        """Wait until everything published so far has been recorded, if the broker still runs."""
        if self._client.is_connected():
            self._ended.clear()
            self._client.publish(_END, b"", 1)
            self._ended.wait(_TIMEOUT)

    def close(self) -> None:
        """Stop when everything published so far has been recorded, if the broker still runs."""
        self.catch_up()
        self._client.disconnect()
        self._client.loop_stop()

    def sent(self, topic: str) -> list[dict[str, Any]]:
        """Messages of the vehicles on topics that end with `topic`."""
        return [
            json.loads(payload) for name, payload in self.messages if name.endswith(f"/{topic}")
        ]

    def check(self) -> None:
        """Check all messages of vehicles with the published schemas."""
        for name, payload in self.messages:
            _, major, _, _, topic = name.split("/")
            if topic in ("order", "instantActions"):
                continue
            found = defect(VERSIONS[major], topic, json.loads(payload))
            assert found is None, (name, payload, found)
