"""The Wi-Fi client of the robot, and the networks within reach."""

from __future__ import annotations

import json
from typing import Any

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.refusals import RefusedError

_REACHABLE = {"woosh-factory": 78, "woosh-guest": 61, "warehouse-2": 34}
"""Signal strengths of the networks within reach, in percent."""

_MAX_SSID = 32
"""Maximum length of an SSID by the standard, in bytes."""

_MAX_KNOWN = 100
"""Maximum number of known networks."""

_Mode = robot_pb2.Network.WiFi


class WiFi:
    """State of the Wi-Fi: the current network and the known ones.

    Attributes:
        name: SSID of the network it is connected to, empty if none.
        hotspot: It is a hotspot instead of a client.
        list_json: Networks found by the last scan, as JSON; empty before the first scan.
    """

    def __init__(self) -> None:
        self.name = "woosh-factory"
        self.hotspot = False
        self.list_json = b""
        self._known = {self.name}

    def state(self) -> robot_pb2.Network.WiFi:
        """Return the state as reported to clients."""
        return robot_pb2.Network.WiFi(
            name=self.name,
            list_json=self.list_json,
            strength=_REACHABLE.get(self.name, 0),
            mode=_Mode.kAP if self.hotspot else _Mode.kClient,
        )

    def scan(self) -> bytes:
        """Scan for networks and return them as JSON."""
        found = [
            {
                "ssid": ssid,
                "signal": signal,
                "known": ssid in self._known,
                "connected": ssid == self.name,
            }
            for ssid, signal in _REACHABLE.items()
        ]
        self.list_json = json.dumps({"wifi_list": found}).encode()
        return self.list_json

    def add(self, content: bytes, *, connect: bool) -> None:
        """Add a network to the known ones.

        Args:
            content: JSON object with an `ssid`.
            connect: Connect to the network.

        Raises:
            RefusedError: The JSON is invalid, the network is out of reach, or too many are known.
        """
        ssid = _ssid(content)
        if ssid not in self._known and len(self._known) >= _MAX_KNOWN:
            raise RefusedError(refusals.TOO_MANY_NETWORKS, limit=_MAX_KNOWN)
        self._known.add(ssid)
        if connect:
            self._connect(ssid)

    def reconnect(self, content: bytes) -> None:
        """Connect to a known network.

        Args:
            content: JSON object with an `ssid`.

        Raises:
            RefusedError: The network is not known or out of reach.
        """
        ssid = _ssid(content)
        if ssid not in self._known:
            raise RefusedError(refusals.NETWORK_NOT_KNOWN, ssid=ssid)
        self._connect(ssid)

    def forget(self, content: bytes) -> None:
        """Remove a network from the known ones.

        Args:
            content: SSID of the network.

        Raises:
            RefusedError: The network is not known.
        """
        ssid = content.decode(errors="replace")
        if ssid not in self._known:
            raise RefusedError(refusals.NO_NETWORK_TO_FORGET, ssid=ssid)
        self._known.remove(ssid)
        if self.name == ssid:
            self.name = ""

    def switch_hotspot(self, *, on: bool) -> None:
        """Become a hotspot, or return to the last network as a client."""
        self.hotspot = on

    def _connect(self, ssid: str) -> None:
        if ssid not in _REACHABLE:
            raise RefusedError(refusals.NETWORK_OUT_OF_REACH, ssid=ssid)
        self.name = ssid
        self.hotspot = False


def _ssid(content: bytes) -> str:
    try:
        parsed: Any = json.loads(content)
    except (ValueError, RecursionError):
        raise RefusedError(refusals.NO_SSID) from None
    ssid = parsed.get("ssid") if isinstance(parsed, dict) else None
    if not isinstance(ssid, str) or not ssid:
        raise RefusedError(refusals.NO_SSID)
    if len(ssid.encode(errors="replace")) > _MAX_SSID:
        raise RefusedError(refusals.SSID_TOO_LONG, limit=_MAX_SSID)
    return ssid
