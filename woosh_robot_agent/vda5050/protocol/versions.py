"""All versions of the standard."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.v2_1 import Version21
from woosh_robot_agent.vda5050.protocol.v3_0 import Version30

VERSIONS: Mapping[str, Callable[[], Version]] = {"2.1": Version21, "3.0": Version30}
"""Versions, by the value of `--version`."""
