"""Frames with which a chassis floods the agent."""

from __future__ import annotations

from typing import Any

FIRST_MAP = 1_000_000
"""Map id of push number 0. It distinguishes the pushes of a flood from the simulator's own."""


def push_mixed(chassis: Any, sent: dict[str, int], count: int) -> None:
    """Push states and status codes, four states for each code.

    Args:
        chassis: The simulator, in its own thread.
        sent: Numbers of `poses` and `codes` pushed so far, updated by each push.
        count: Number of further pushes.
    """
    for _ in range(count):
        kind = "codes" if sent["codes"] * 4 < sent["poses"] else "poses"
        sent[kind] += 1
        chassis.send_raw(pose(sent[kind]) if kind == "poses" else code(sent[kind]))


def pose(number: int) -> str:
    """Return the push of a pose with this number."""
    return f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":{FIRST_MAP + number}}}}}'


def code(number: int) -> str:
    """Return the push of a status code with this number."""
    return f'{{"type":"woosh.robot.count.StatusCode","body":{{"code":"{number}"}}}}'


def big_frames(size: int) -> list[str]:
    """Return large frames: two pushes without a subscription, and two with unknown fields."""
    text = "x" * size
    row = '{"id":1,"x":0.25,"y":-1.5,"name":"A1"}'
    rows = ",".join([row] * (size // (len(row) + 1)))
    return [
        f'{{"type":"woosh.map.SceneData","body":{{"name":"{text}"}}}}',
        f'{{"type":"woosh.map.SceneDataEasy","sn":2000000000,"ok":true,"body":{{"x":[{rows}]}}}}',
        f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":6,"extra":"{text}"}}}}',
        f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":6,"extra":[{rows}]}}}}',
    ]
