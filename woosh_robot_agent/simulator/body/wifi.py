"""The chassis's WiFi, with some networks in the air around it."""

from __future__ import annotations

import json
from typing import Any

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.simulator.errors import Refused

_IN_THE_AIR = {"woosh-factory": 78, "woosh-guest": 61, "warehouse-2": 34}

#: Bytes, as the standard says.
_LONGEST_SSID = 32
_MOST_KNOWN = 100

_Mode = robot_pb2.Network.WiFi


class WiFi:
    """What the chassis is connected to and what it knows.

    Attributes:
        name: The network it is connected to, empty if none.
        hotspot: It is a hotspot itself instead.
        list_json: The networks of the last scan as JSON, empty before the first one.
    """

    def __init__(self) -> None:
        self.name = "woosh-factory"
        self.hotspot = False
        self.list_json = b""
        self._known = {self.name}

    def state(self) -> robot_pb2.Network.WiFi:
        """What reports say about it."""
        return robot_pb2.Network.WiFi(
            name=self.name,
            list_json=self.list_json,
            strength=_IN_THE_AIR.get(self.name, 0),
            mode=_Mode.kAP if self.hotspot else _Mode.kClient,
        )

    def scan(self) -> bytes:
        """Look for networks."""
        found = [
            {
                "ssid": ssid,
                "signal": signal,
                "known": ssid in self._known,
                "connected": ssid == self.name,
            }
            for ssid, signal in _IN_THE_AIR.items()
        ]
        self.list_json = json.dumps({"wifi_list": found}).encode()
        return self.list_json

    def add(self, content: bytes, *, connect: bool) -> None:
        """Learn the network that a JSON object names in its `ssid`.

        Raises:
            Refused: There is no such object, the network is out of reach, or too many are known.
        """
        ssid = _ssid(content)
        if ssid not in self._known and len(self._known) >= _MOST_KNOWN:
            raise Refused(f"{_MOST_KNOWN} networks are known already: forget one first")
        self._known.add(ssid)
        if connect:
            self._connect(ssid)

    def reconnect(self, content: bytes) -> None:
        """Connect to a network that is known already.

        Raises:
            Refused: It is not known, or out of reach.
        """
        ssid = _ssid(content)
        if ssid not in self._known:
            raise Refused(f"WiFi {ssid} is not known: add it first")
        self._connect(ssid)

    def forget(self, content: bytes) -> None:
        """Forget the network of this name.

        Raises:
            Refused: It is not known.
        """
        ssid = content.decode(errors="replace")
        if ssid not in self._known:
            raise Refused(f"WiFi {ssid} is not known")
        self._known.remove(ssid)
        if self.name == ssid:
            self.name = ""

    def switch_hotspot(self, *, on: bool) -> None:
        """Be a hotspot, or a client of the network that was connected last."""
        self.hotspot = on

    def _connect(self, ssid: str) -> None:
        if ssid not in _IN_THE_AIR:
            raise Refused(f"WiFi {ssid} is out of reach")
        self.name = ssid
        self.hotspot = False


def _ssid(content: bytes) -> str:
    try:
        parsed: Any = json.loads(content)
    except (ValueError, RecursionError):
        raise Refused("content is not a JSON object with an ssid") from None
    ssid = parsed.get("ssid") if isinstance(parsed, dict) else None
    if not isinstance(ssid, str) or not ssid:
        raise Refused("content is not a JSON object with an ssid")
    if len(ssid.encode(errors="replace")) > _LONGEST_SSID:
        raise Refused(f"the ssid is longer than {_LONGEST_SSID} bytes, which no network's is")
    return ssid
