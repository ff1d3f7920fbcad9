"""The agent's parameters: one table of names, defaults, ranges and meanings."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.parameter import Parameter
from woosh_robot_agent.standard import settings as standard
from woosh_robot_agent.standard.settings import StandardSettings

EXECUTORS = ("events", "single")


_LINK = LinkConfig()

PARAMETERS = (
    Parameter("ip", _LINK.ip, "Address or host name of the chassis", link_field="ip"),
    Parameter(
        "port",
        _LINK.port,
        "Port of the chassis; 0 is the transport's default, 5480 for websocket and 5481 for tcp",
        0,
        65535,
        "port",
    ),
    Parameter(
        "transport", _LINK.transport, "How to connect: websocket or tcp", link_field="transport"
    ),
    Parameter(
        "encoding",
        _LINK.encoding,
        "Encoding of the frames: json or protobuf; tcp is always protobuf",
        link_field="encoding",
    ),
    Parameter("poll_timeout", 10000, "Longest wait for an answer of the chassis, ms", 1, 3_600_000),
    Parameter(
        "robot_id",
        _LINK.robot_id,
        "Id of the robot that requests are meant for; 0 is not sent",
        0,
        2**32 - 1,
        "robot_id",
    ),
    Parameter(
        "goal_link_timeout", 5.0, "How long goals stay open while the link is lost, s", 0.0, 3600.0
    ),
    Parameter(
        "result_timeout",
        60,
        "How long results of goals that ended are kept for late clients, s",
        1,
        86400,
        fixed=True,
    ),
    Parameter("executor", EXECUTORS[0], "rclpy's executor: events or single", fixed=True),
    Parameter(
        "robots",
        ("",),
        "Namespaces of the robots, if this process serves several; each has its own parameters",
        fixed=True,
    ),
    Parameter(
        "connect_timeout",
        _LINK.connect_timeout,
        "Longest wait for a connection to open, s",
        0.1,
        60.0,
        "connect_timeout",
    ),
    Parameter(
        "handshake_timeout",
        _LINK.handshake_timeout,
        "Longest wait for the first RobotInfo, which makes the link ready, s",
        0.1,
        60.0,
        "handshake_timeout",
    ),
    Parameter(
        "close_timeout",
        _LINK.close_timeout,
        "Longest wait for an orderly close of the connection, s",
        0.1,
        2.0,
        "close_timeout",
    ),
    Parameter(
        "liveness_timeout",
        _LINK.liveness_timeout,
        "Silence, pings unanswered, after which the link counts as lost, s",
        0.5,
        600.0,
        "liveness_timeout",
    ),
    Parameter(
        "backoff_min",
        _LINK.backoff_min,
        "Pause before the first attempt to connect again, s; each further one is twice as long",
        0.05,
        60.0,
        "backoff_min",
    ),
    Parameter(
        "backoff_max",
        _LINK.backoff_max,
        "Longest pause between attempts to connect, s",
        0.05,
        3600.0,
        "backoff_max",
    ),
    Parameter(
        "stable_after",
        _LINK.stable_after,
        "How long a link must be ready before the pauses start small again, s",
        0.0,
        3600.0,
        "stable_after",
    ),
    Parameter(
        "max_frame_size",
        _LINK.max_frame_size,
        "Largest frame that is accepted from the chassis, bytes",
        1024,
        2**31 - 1,
        "max_frame_size",
    ),
    Parameter(
        "max_in_flight",
        _LINK.max_in_flight,
        "Requests that may wait for the chassis's answer at one time; further ones fail at once",
        1,
        10000,
        "max_in_flight",
    ),
    Parameter(
        "push_queue",
        _LINK.push_queue,
        "Status codes, task reports or feedbacks that may wait to be published",
        1,
        1_000_000,
        "push_queue",
    ),
    *standard.PARAMETERS,
)
_BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}


@dataclass(frozen=True)
class Settings:
    """The parameters' values, checked.

    Attributes:
        link: everything about the link.
        goal_link_timeout: s for which goals stay open without a link.
        result_timeout: s for which results are kept.
        executor: one of `EXECUTORS`.
        robots: names of the robots that the process serves; empty for one.
        standard: those of the standard layer.
    """

    link: LinkConfig
    goal_link_timeout: float
    result_timeout: int
    executor: str
    robots: tuple[str, ...]
    standard: StandardSettings


def check(values: Mapping[str, Any]) -> Settings:
    """Settings of parameter values, one for each of `PARAMETERS`.

    Raises:
        ValueError: a value makes no sense; the text says which and why.
    """
    for name, value in values.items():
        _BY_NAME[name].check(value)
    link = {p.link_field: values[p.name] for p in PARAMETERS if p.link_field}
    if values["executor"] not in EXECUTORS:
        raise ValueError(f"executor {values['executor']!r} is not one of {list(EXECUTORS)}")
    return Settings(
        link=LinkConfig(**link, request_timeout=values["poll_timeout"] / 1000),
        goal_link_timeout=float(values["goal_link_timeout"]),
        result_timeout=values["result_timeout"],
        executor=values["executor"],
        # ROS has no empty array in a file: one empty name stands for it
        robots=() if list(values["robots"]) == [""] else tuple(values["robots"]),
        standard=StandardSettings(**{p.name: values[p.name] for p in standard.PARAMETERS}),
    )


def markdown() -> str:
    """The table of parameters in Markdown, as the README shows it."""
    rows = ["| Parameter | Default | Range | Meaning |", "| --- | --- | --- | --- |"]
    for p in PARAMETERS:
        note = "; at the start only" if p.fixed else ""
        rows.append(f"| `{p.name}` | `{p.shown}` | {p.limits} | {p.description}{note} |")
    return "\n".join(rows)


def yaml() -> str:
    """All parameters with their defaults as a parameter file, as in config/agent.yaml."""
    lines = ["# Every parameter of the agent at its default, as a file for ros2 run and launch:"]
    lines += [
        "#   ros2 run woosh_robot_agent agent --ros-args -r __ns:=/woosh_robot --params-file FILE",
        "# Keep what you change, and leave out the rest.",
        "/**:",
        "  ros__parameters:",
    ]
    for p in PARAMETERS:
        limits = f"; {p.limits}" if p.limits else ""
        lines.append(f"    # {p.description}{limits}")
        lines.append(f"    {p.name}: {json.dumps(p.initial)}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(yaml() if "--yaml" in sys.argv else markdown() + "\n", end="")
