"""A map of the chassis as a map of nav2's map_server: a YAML file and a PNG."""

from __future__ import annotations

import math
import struct

import yaml

from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.robot.maps import FREE_THRESHOLD, OCCUPIED_THRESHOLD, MapError, grey_png


def map_files(area: SceneData.Map, stem: str) -> dict[str, bytes]:
    """Return the YAML file and the PNG of a map, by name.

    They have the values of the agent's topic `map`.

    Args:
        area: The map.
        stem: Names of the files without their suffixes.

    Raises:
        MapError: The robot has not sent a usable map.
    """
    if not area.map_png:
        raise MapError("the robot sent no image")
    png = grey_png(area.map_png)
    if not 0 < area.resolution < math.inf:
        raise MapError(f"its resolution is invalid: {area.resolution:g}")
    origin = area.origin
    description = {
        "image": f"{stem}.png",
        "mode": "trinary",
        "resolution": shortest(area.resolution),
        "origin": [shortest(value) for value in (origin.x, origin.y, origin.theta)],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESHOLD,
        "free_thresh": FREE_THRESHOLD,
    }
    text = yaml.safe_dump(description, sort_keys=False, allow_unicode=True, default_flow_style=None)
    return {f"{stem}.yaml": text.encode(), f"{stem}.png": png}


def shortest(value: float) -> float:
    """Return the number with the fewest digits that is the same in 32 bits: 0.05, not 0.0500000007.

    The chassis sends numbers of 32 bits.
    """
    bits = struct.pack("f", value)
    for digits in range(1, 9):
        short = float(f"{value:.{digits}g}")
        if struct.pack("f", short) == bits:
            return short
    return value
