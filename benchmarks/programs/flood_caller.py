"""Call `robot/Speak` at a fixed rate and report the answers.

    python -m benchmarks.programs.flood_caller RATE SECONDS

Prints `ready` when the service is there and begins after a line on stdin. At the end it prints one
JSON object.
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

from woosh_robot_agent.testing.agents import NAMESPACE
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.srv import Speak

ANSWER_TIMEOUT = 300.0
"""Timeout for answers after the last call, in seconds."""


class Caller:
    """Calls the service and counts the answers to each call.

    Uses rclpy's client without an executor. An executor would cost more than the calls and would
    hide duplicate answers.
    """

    def __init__(self) -> None:
        self._request = Speak.Request(arg=SpeakMsg(text="a flood"))
        node = Node(f"caller_{os.getpid()}")
        # deep enough for all answers: one that DDS overwrites would count as missing
        self._client = node.create_client(
            Speak, f"{NAMESPACE}/robot/Speak", qos_profile=QoSProfile(depth=50_000)
        )
        self._sent: dict[int, float] = {}
        """Time of each call, by its sequence number."""
        self._answers: Counter[int] = Counter()
        self._kinds: Counter[str] = Counter()
        self._waits: list[float] = []

    def wait_for_service(self) -> None:
        """Wait until the service is available."""
        while not self._client.service_is_ready():
            time.sleep(0.05)

    def flood(self, rate: float, seconds: float) -> dict[str, Any]:
        """Call at a rate in Hz, wait for the answers and return a summary of them."""
        begin = time.monotonic()
        while (elapsed := time.monotonic() - begin) < seconds:
            while len(self._sent) < elapsed * rate:
                number = self._client.handle.send_request(self._request)
                self._sent[number] = time.monotonic()
            if not self._take_answer():
                time.sleep(0.001)
        duration = time.monotonic() - begin
        deadline = time.monotonic() + ANSWER_TIMEOUT
        while len(self._answers) < len(self._sent) and time.monotonic() < deadline:
            if not self._take_answer():
                time.sleep(0.01)
        waits = sorted(self._waits) or [0.0]
        return {
            "sent": len(self._sent),
            "seconds": duration,
            "answered": len(self._answers),
            "duplicates": sum(count > 1 for count in self._answers.values()),
            "kinds": dict(self._kinds),
            "median": waits[len(waits) // 2],
            "longest": waits[-1],
        }

    def _take_answer(self) -> bool:
        """Take an answer; return False if there is none."""
        header, response = self._client.handle.take_response(Speak.Response)
        if header is None:
            return False
        number = header.request_id.sequence_number
        self._answers[number] += 1
        self._waits.append(time.monotonic() - self._sent[number])
        self._kinds[_kind(response)] += 1
        return True


def _kind(response: Any) -> str:
    if response.ok:
        return "ok"
    return "too many" if "raise max_in_flight" in response.msg else response.msg[:60]


def main(rate: str, seconds: str) -> None:
    rclpy.init()
    caller = Caller()
    caller.wait_for_service()
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps(caller.flood(float(rate), float(seconds))), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
