"""A program that calls a service at a rate: `python -m benchmarks.caller RATE SECONDS SERVICE`.

Says `ready` when the service is there, begins at a line on stdin, and tells in the end, as JSON,
what became of the calls.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import Counter
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile

from tests.harness import NAMESPACE
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.srv import Mode, Speak

SERVICES = {
    "Speak": (Speak, Speak.Request(arg=SpeakMsg(text="a flood"))),
    "Mode": (Mode, Mode.Request()),
}
PATIENCE = 90.0
"""s after the last call in which every call must have been answered."""


class Caller:
    """Calls, and counts the answers to each call.

    It uses rclpy's client without an executor, which would cost more than the calls themselves, and
    would hide a second answer.
    """

    def __init__(self, name: str) -> None:
        self.node = Node(f"caller_{os.getpid()}")
        self._srv, self._request = SERVICES[name]
        # deep enough for all answers: what DDS overwrites here would look like an answer not given
        self._client = self.node.create_client(
            self._srv, f"{NAMESPACE}/robot/{name}", qos_profile=QoSProfile(depth=50_000)
        )
        self._sent: dict[int, float] = {}
        """When calls were made, by their number."""
        self._answers: Counter[int] = Counter()
        self._kinds: Counter[str] = Counter()
        self._waits: list[float] = []

    def wait(self) -> None:
        """Return when the service is there."""
        while not self._client.service_is_ready():
            time.sleep(0.05)

    def flood(self, rate: float, seconds: float) -> dict[str, Any]:
        """Call at `rate` per s, then wait for the answers; returns what became of the calls."""
        begun = time.monotonic()
        while (passed := time.monotonic() - begun) < seconds:
            while len(self._sent) < passed * rate:
                number = self._client.handle.send_request(self._request)
                self._sent[number] = time.monotonic()
            if not self._take():
                time.sleep(0.001)
        lasted = time.monotonic() - begun
        until = time.monotonic() + PATIENCE
        while len(self._answers) < len(self._sent) and time.monotonic() < until:
            if not self._take():
                time.sleep(0.01)
        waits = sorted(self._waits) or [0.0]
        return {
            "sent": len(self._sent),
            "seconds": lasted,
            "answered": len(self._answers),
            "twice": sum(count > 1 for count in self._answers.values()),
            "kinds": dict(self._kinds),
            "median": waits[len(waits) // 2],
            "longest": waits[-1],
        }

    def _take(self) -> bool:
        """Take an answer; whether there was one."""
        header, response = self._client.handle.take_response(self._srv.Response)
        if header is None:
            return False
        number = header.request_id.sequence_number
        self._answers[number] += 1
        self._waits.append(time.monotonic() - self._sent[number])
        self._kinds[_kind(response)] += 1
        return True


def _kind(response: Any) -> str:
    if not hasattr(response, "ok"):
        return "value"
    if response.ok:
        return "ok"
    return "too many" if "raise max_in_flight" in response.msg else response.msg[:60]


def main(rate: str, seconds: str, name: str) -> None:
    rclpy.init()
    caller = Caller(name)
    caller.wait()
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps(caller.flood(float(rate), float(seconds))), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
