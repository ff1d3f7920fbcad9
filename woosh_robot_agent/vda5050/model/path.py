"""The path ahead of the vehicle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

Point: TypeAlias = tuple[float, float]

_PRECISION = 0.02
"""Maximum distance of a simplified path from the original one, in metres."""
_MAX_OFFSET = 1.0
"""Maximum distance of the vehicle from a path that it follows, in metres."""


def path_ahead(path: Sequence[Point], here: Point) -> list[Point]:
    """Return the rest of a path from the position of the vehicle, simplified.

    Args:
        path: points of the path.
        here: position of the vehicle.

    Returns:
        At least two points, the first of which is the position; empty if there is no path ahead.
    """
    if not path:
        return []
    nearest = min(range(len(path)), key=lambda index: math.dist(path[index], here))
    if math.dist(path[nearest], here) > _MAX_OFFSET:
        return []
    if nearest + 1 < len(path) and _is_behind(path[nearest], path[nearest + 1], here):
        nearest += 1
    ahead = [here, *(point for point in path[nearest:] if point != here)]
    return _simplified(ahead) if len(ahead) > 1 else []


def _is_behind(point: Point, following: Point, here: Point) -> bool:
    """Return True if the vehicle has passed a point on its way to the following one."""
    along = (following[0] - point[0], following[1] - point[1])
    return along[0] * (here[0] - point[0]) + along[1] * (here[1] - point[1]) > 0


def _simplified(path: Sequence[Point]) -> list[Point]:
    """Simplify a path with the Ramer-Douglas-Peucker algorithm."""
    kept = {0, len(path) - 1}
    sections = [(0, len(path) - 1)]
    while sections:
        first, last = sections.pop()
        offsets = [
            (_offset(path[index], path[first], path[last]), index)
            for index in range(first + 1, last)
        ]
        if offsets and max(offsets)[0] > _PRECISION:
            middle = max(offsets)[1]
            kept.add(middle)
            sections += [(first, middle), (middle, last)]
    return [path[index] for index in sorted(kept)]


def _offset(point: Point, start: Point, end: Point) -> float:
    """Return the distance of a point from a line between two points, in metres."""
    along = (end[0] - start[0], end[1] - start[1])
    across = (point[0] - start[0], point[1] - start[1])
    length = along[0] ** 2 + along[1] ** 2
    part = 0.0
    if length:
        part = min(1.0, max(0.0, (along[0] * across[0] + along[1] * across[1]) / length))
    return math.hypot(across[0] - part * along[0], across[1] - part * along[1])
