"""The agent's parameters: the table of all of them, and their checked values.

`python3 -m woosh_robot_agent.parameters` prints the table in Markdown, with `--yaml` as a parameter
file.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.parameter import Parameter, parameter_field, parameters_of
from woosh_robot_agent.standard.settings import StandardSettings

EXECUTORS = ("events", "single")
"""Values of the parameter `executor`, the default first."""

_LINK_DEFAULTS = LinkConfig()


def _link(name: str, description: str, low: float = 0, high: float = 0) -> Parameter:
    """Return the parameter that sets a field of `LinkConfig`; both have the same name."""
    return Parameter(name, getattr(_LINK_DEFAULTS, name), description, low, high)


_LINK_PARAMETERS = (
    _link("ip", "IP address or host name of the chassis."),
    _link(
        "port",
        "Port of the chassis; 0 selects the default of the transport, 5480 for websocket and 5481 "
        "for tcp.",
        0,
        65535,
    ),
    _link("transport", "Transport of the link: websocket or tcp."),
    _link("encoding", "Encoding of the frames: json or protobuf; tcp always uses protobuf."),
    _link(
        "robot_id",
        "Id of the robot in requests, for gateways that serve several robots; 0 sends no id.",
        0,
        2**32 - 1,
    ),
    _link("connect_timeout", "Timeout for opening the connection, in seconds.", 0.1, 60.0),
    _link(
        "handshake_timeout",
        "Timeout for the first RobotInfo, with which the link becomes ready, in seconds.",
        0.1,
        60.0,
    ),
    _link("close_timeout", "Timeout for an orderly end of the connection, in seconds.", 0.1, 2.0),
    _link(
        "liveness_timeout",
        "Time without a sign of life from the chassis after which the link counts as lost, in "
        "seconds.",
        0.5,
        600.0,
    ),
    _link(
        "backoff_min",
        "Delay before the first attempt to reconnect, in seconds; it doubles with each attempt.",
        0.05,
        60.0,
    ),
    _link("backoff_max", "Maximum delay between attempts to reconnect, in seconds.", 0.05, 3600.0),
    _link(
        "stable_after",
        "Time that the link must be ready before the delay returns to backoff_min, in seconds.",
        0.0,
        3600.0,
    ),
    _link("max_frame_size", "Maximum size of a frame from the chassis, in bytes.", 1024, 2**31 - 1),
    _link(
        "max_in_flight",
        "Maximum number of requests in flight; further requests fail at once.",
        1,
        10000,
    ),
    _link(
        "push_queue",
        "Maximum number of status codes, task reports or feedbacks that wait to be published; the "
        "oldest are dropped.",
        1,
        1_000_000,
    ),
)


@dataclass(frozen=True)
class Settings:
    """The checked values of all parameters.

    Attributes:
        link: configuration of the link.
        standard: settings of the standard layer.
    """

    link: LinkConfig
    standard: StandardSettings
    poll_timeout: int = parameter_field(
        10000,
        "Timeout for the chassis's answer to a request, in milliseconds. Slow requests have a "
        "longer one of their own, see the table of endpoints.",
        1,
        3_600_000,
    )
    observe_only: bool = parameter_field(
        False,
        "Only read from the robot: refuse everything that could change or move something, for "
        "dashboards and for a second agent on the same robot.",
    )
    goal_link_timeout: float = parameter_field(
        15.0, "Time without a link after which open goals are aborted, in seconds.", 0.0, 3600.0
    )
    result_timeout: int = parameter_field(
        60,
        "Time that the result of an ended goal stays available to clients, in seconds.",
        1,
        86400,
        read_only=True,
    )
    executor: str = parameter_field(
        EXECUTORS[0], "Executor of rclpy: events or single.", read_only=True
    )
    robots: tuple[str, ...] = parameter_field(
        ("",),
        "Namespaces of the robots, if this process serves several; each has its own parameters.",
        read_only=True,
    )


_OWN_PARAMETERS = parameters_of(Settings)
_STANDARD_PARAMETERS = parameters_of(StandardSettings)
PARAMETERS = (*_LINK_PARAMETERS, *_OWN_PARAMETERS, *_STANDARD_PARAMETERS)
"""All parameters of the agent, in the order of the documentation."""
_BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}


def check(values: Mapping[str, Any]) -> Settings:
    """Return the settings for parameter values, one value for each of `PARAMETERS`.

    Raises:
        ValueError: a value is invalid; the text says which one and why.
    """
    for name, value in values.items():
        _BY_NAME[name].check(value)
    if values["executor"] not in EXECUTORS:
        raise ValueError(f"executor must be one of {list(EXECUTORS)}, not {values['executor']!r}")
    own = {parameter.name: values[parameter.name] for parameter in _OWN_PARAMETERS}
    # a parameter file cannot hold an empty array: one empty name stands for it
    own["robots"] = () if list(own["robots"]) == [""] else tuple(own["robots"])
    return Settings(
        link=LinkConfig(
            **{parameter.name: values[parameter.name] for parameter in _LINK_PARAMETERS},
            request_timeout=values["poll_timeout"] / 1000,
        ),
        standard=StandardSettings(**{p.name: values[p.name] for p in _STANDARD_PARAMETERS}),
        **own,
    )


def markdown() -> str:
    """Return the table of parameters in Markdown."""
    rows = ["| Parameter | Default | Range | Meaning |", "| --- | --- | --- | --- |"]
    for p in PARAMETERS:
        note = " Read-only." if p.read_only else ""
        rows.append(f"| `{p.name}` | `{p.shown}` | {p.limits} | {p.description}{note} |")
    return "\n".join(rows)


def yaml() -> str:
    """Return a parameter file with all parameters at their defaults."""
    lines = [
        "# All parameters of the agent with their defaults. Use it with",
        "#   ros2 run woosh_robot_agent agent --ros-args -r __ns:=/woosh_robot --params-file FILE",
        "# or with launch (params_file:=FILE). Keep only the lines that you change.",
        "/**:",
        "  ros__parameters:",
    ]
    for p in PARAMETERS:
        limits = f" Range: {p.limits}." if p.limits else ""
        lines.append(f"    # {p.description}{limits}")
        lines.append(f"    {p.name}: {json.dumps(p.initial)}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(yaml() if "--yaml" in sys.argv else markdown() + "\n", end="")
