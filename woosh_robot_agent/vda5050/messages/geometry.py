"""Geometry of lines, paths, and trajectories, which are NURBS."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TypeAlias

from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.messages.order import MAX_CONTROL_POINTS, MAX_DEGREE, Trajectory

Point: TypeAlias = tuple[float, float]
"""Position in the map frame, in metres."""


def nearest_on_line(point: Point, start: Point, end: Point) -> Point:
    """Return the point of the straight line from `start` to `end` that is nearest to `point`."""
    along = (end[0] - start[0], end[1] - start[1])
    squared_length = along[0] ** 2 + along[1] ** 2
    if not squared_length:
        return end
    product = (point[0] - start[0]) * along[0] + (point[1] - start[1]) * along[1]
    fraction = min(1.0, max(0.0, product / squared_length))
    return start[0] + fraction * along[0], start[1] + fraction * along[1]


_SPACING = 0.25
"""Usual distance between two points along a curve, in metres."""
_MAX_POINTS = 100
"""Approximate maximum number of points along a curve; on a longer curve, they are farther apart."""
_SAMPLES = 8
"""Number of points in each knot span by which the length of the curve is estimated."""
_MIN_WEIGHT = 1e-9
"""Lowest permitted weight. Points are divided by a mean of weights, which could underflow to 0."""
_HIGH_DEGREE = Sentence("its degree is above {most}: {degree}")
_MANY_POINTS = Sentence("it has more than {most} control points: {count}")
_FEW_POINTS = Sentence("degree {degree} needs at least {least} control points: {count}")
_KNOTS = Sentence("{points} control points of degree {degree} need {needed} knots: {count}")
_DECREASE = Sentence("its knots decrease")
_EQUAL = Sentence("its knots are all equal")
_WEIGHT = Sentence("a weight is below {least}")
_NO_LENGTH = Sentence("it has no length")


def curve_defect(trajectory: Trajectory) -> str:
    """Return why a trajectory, which fits the schema, is no valid NURBS; empty if it is valid."""
    degree, knots, points = trajectory.degree, trajectory.knots, trajectory.points
    if degree > MAX_DEGREE:
        return _HIGH_DEGREE(most=MAX_DEGREE, degree=degree)
    if len(points) > MAX_CONTROL_POINTS:
        return _MANY_POINTS(most=MAX_CONTROL_POINTS, count=len(points))
    if len(points) <= degree:
        return _FEW_POINTS(degree=degree, least=degree + 1, count=len(points))
    needed = len(points) + degree + 1
    if len(knots) != needed:
        return _KNOTS(points=len(points), degree=degree, needed=needed, count=len(knots))
    if any(after < before for before, after in pairwise(knots)):
        return _DECREASE()
    if knots[degree] == knots[len(points)]:
        return _EQUAL()
    if any(point.weight < _MIN_WEIGHT for point in points):
        return _WEIGHT(least=f"{_MIN_WEIGHT:g}")
    if len(set(curve_points(trajectory))) == 1:  # also if its other control points have no effect
        return _NO_LENGTH()
    return ""


@functools.lru_cache(maxsize=256)
def curve_points(trajectory: Trajectory) -> tuple[Point, ...]:
    """Return points along a valid trajectory (see `curve_defect`), from its start to its end.

    They are about `_SPACING` apart or less, except on a straight line or a long curve.
    """
    degree, knots = trajectory.degree, trajectory.knots
    spans = [
        span for span in range(degree, len(trajectory.points)) if knots[span] < knots[span + 1]
    ]
    lengths = [_length(_points_of_span(trajectory, span, _SAMPLES)) for span in spans]
    spacing = max(_SPACING, sum(lengths) / _MAX_POINTS)
    # a short span is divided, too, because it may bend; not if there are many spans
    min_count = 1 if len(spans) * degree > _MAX_POINTS else degree
    points = [_point(trajectory, spans[0], knots[spans[0]])]
    for span, length in zip(spans, lengths, strict=True):
        # a straight line needs only its end
        count = 1 if degree == 1 else max(min_count, math.ceil(length / spacing))
        points += _points_of_span(trajectory, span, count)[1:]
    return tuple(points if len(points) <= _MAX_POINTS else _simplified(points))


def _length(points: list[Point]) -> float:
    return sum(math.dist(before, after) for before, after in pairwise(points))


def _points_of_span(trajectory: Trajectory, span: int, count: int) -> list[Point]:
    """Return the points at the start and end of a span of the knots, and `count` - 1 between."""
    start, end = trajectory.knots[span : span + 2]
    parameters = [start + (end - start) * step / count for step in range(count)]
    return [_point(trajectory, span, each) for each in (*parameters, end)]


def _point(trajectory: Trajectory, span: int, parameter: float) -> Point:
    """Return the point of a curve at a parameter, which is in the span after knot number `span`.

    This is de Boor's algorithm.
    """
    degree, knots = trajectory.degree, trajectory.knots
    control = trajectory.points[span - degree : span + 1]
    # in homogeneous coordinates a rational curve is an ordinary one
    values = [(each.x * each.weight, each.y * each.weight, each.weight) for each in control]
    for level in range(1, degree + 1):
        for index in range(degree, level - 1, -1):
            low = knots[span - degree + index]
            width = knots[index + 1 + span - level] - low
            fraction = (parameter - low) / width if width else 0.0
            values[index] = tuple(  # type: ignore[assignment]
                (1 - fraction) * before + fraction * after
                for before, after in zip(values[index - 1], values[index], strict=True)
            )
    x, y, weight = values[degree]
    return x / weight, y / weight


_PRECISION = 0.02
"""Maximum distance of a simplified path from the original one, in metres."""
_MAX_OFFSET = 1.0
"""Maximum distance of the vehicle from a path that it follows, in metres."""


def path_ahead(path: Sequence[Point], here: Point) -> list[Point]:
    """Return the rest of a path from the position of the vehicle, simplified.

    Returns:
        At least two points, the first of which is the position; empty if there is no path ahead, or
        if the vehicle is farther than `_MAX_OFFSET` from the path.
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
    """Return True if the vehicle has passed a point on its way to the following point."""
    along = (following[0] - point[0], following[1] - point[1])
    return along[0] * (here[0] - point[0]) + along[1] * (here[1] - point[1]) > 0


def _simplified(path: Sequence[Point]) -> list[Point]:
    """Leave out points of a path with the Ramer-Douglas-Peucker algorithm.

    No point that is left out is farther than `_PRECISION` from the simplified path.
    """
    kept = {0, len(path) - 1}
    sections = [(0, len(path) - 1)]
    while sections:
        first, last = sections.pop()
        line = path[first], path[last]
        offsets = [
            (math.dist(path[index], nearest_on_line(path[index], *line)), index)
            for index in range(first + 1, last)
        ]
        if offsets and max(offsets)[0] > _PRECISION:
            middle = max(offsets)[1]
            kept.add(middle)
            sections += [(first, middle), (middle, last)]
    return [path[index] for index in sorted(kept)]
