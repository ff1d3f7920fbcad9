"""Call `robot/Speak` at a fixed rate and report the answers.

    python -m benchmarks.programs.flood_caller

Prints `ready` when the service has answered a call. For each line on stdin, with a rate in Hz and a
duration in seconds, it makes a flood of calls and prints one JSON object.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import time
from collections import Counter
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.node import Node
from rclpy.qos import QoSProfile

from woosh_robot_agent.testing.agents import NAMESPACE
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.srv import Speak

ANSWER_TIMEOUT = 300.0
"""Timeout for answers after the last call, in seconds."""
_FIRST_ANSWER_TIMEOUT = 2.0
"""Time after which the first call is repeated, in seconds."""


class Caller:
    """Calls the service and counts the answers to each call.

    Uses rclpy's client without an executor. An executor would cost more than the calls and would
    hide duplicate answers.
    """

    def __init__(self) -> None:
        self._request = Speak.Request(arg=SpeakMsg(text="a flood"))
        self._node = Node(f"caller_{os.getpid()}")
        # deep enough for all answers: one that DDS overwrites would count as missing
        self._qos = QoSProfile(depth=50_000)
        self._client = self._new_client()
        self._sent: dict[int, float] = {}
        """Time of each call, by its sequence number."""
        self._answers: Counter[int] = Counter()
        """Number of answers to each call, by its sequence number."""
        self._kinds: Counter[str] = Counter()
        """Number of answers, by their result: `ok`, or why the call was refused."""
        self._waits: list[float] = []
        """Times from a call to its answer, in seconds."""

    def _new_client(self) -> Client[Speak.Request, Speak.Response]:
        return self._node.create_client(Speak, f"{NAMESPACE}/robot/Speak", qos_profile=self._qos)

    def wait_for_service(self) -> None:
        """Wait until the service has answered a call.

        `service_is_ready` is true when this process has discovered the service. Only an answer
        shows that the agent has discovered both endpoints of this client. DDS may drop requests
        and answers that are sent before.
        """
        while not self._client.service_is_ready():
            time.sleep(0.05)
        for attempt in itertools.count(1):
            if self._call_once():
                return
            if attempt % 10 == 0:  # on a busy machine, DDS sometimes never matches a client
                self._node.destroy_client(self._client)
                self._client = self._new_client()

    def _call_once(self) -> bool:
        """Call once and wait for an answer; return False after a timeout."""
        self._client.handle.send_request(self._request)
        deadline = time.monotonic() + _FIRST_ANSWER_TIMEOUT
        while time.monotonic() < deadline:
            header, _response = self._client.handle.take_response(Speak.Response)
            if header is not None:
                return True
            time.sleep(0.01)
        return False

    def flood(self, rate: float, seconds: float) -> dict[str, Any]:
        """Call at a rate in Hz, wait for the answers and return a summary of them."""
        for each in (self._sent, self._answers, self._kinds, self._waits):
            each.clear()
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
            "missing": _ranges(sorted(self._sent.keys() - self._answers.keys())),
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
        if number not in self._sent:  # a late answer to a call before this flood
            return True
        self._answers[number] += 1
        self._waits.append(time.monotonic() - self._sent[number])
        self._kinds[_kind(response)] += 1
        return True


def _ranges(numbers: list[int]) -> str:
    """Return ascending numbers as text, e.g. "2-4 9"."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and ranges[-1][-1] == number - 1:
            ranges[-1] = [ranges[-1][0], number]
        else:
            ranges.append([number])
    return " ".join("-".join(map(str, each)) for each in ranges)


def _kind(response: Any) -> str:
    if response.ok:
        return "ok"
    return "too many" if "requests are in flight" in response.msg else response.msg[:60]


def main() -> None:
    rclpy.init()
    caller = Caller()
    caller.wait_for_service()
    print("ready", flush=True)
    for line in sys.stdin:
        rate, seconds = map(float, line.split())
        print(json.dumps(caller.flood(rate, seconds)), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
