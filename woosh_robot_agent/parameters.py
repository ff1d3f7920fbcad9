"""The agent's parameters: one table of names, defaults, ranges and meanings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from woosh_robot_agent.link import LinkConfig

EXECUTORS = ("single_threaded", "events")


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Attributes:
        name: its ROS name.
        default: its default, which also gives its type.
        description: meaning and unit.
        low, high: range of a number, both ends included.
        link_field: field of `LinkConfig` that it sets, in s, bytes or pieces; empty for none.
        fixed: whether it can be set at the start only.
    """

    name: str
    default: str | int | float
    description: str
    low: float = 0
    high: float = 0
    link_field: str = ""
    fixed: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """As ROS's tools show it."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=self.fixed,
            # a whole number is accepted where a fractional one is meant
            dynamic_typing=isinstance(self.default, float),
        )
        if isinstance(self.default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)
            ]
        elif isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(self.low), to_value=float(self.high), step=0.0)
            ]
        return descriptor


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
    Parameter("executor", EXECUTORS[0], "rclpy's executor: single_threaded or events", fixed=True),
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
    """

    link: LinkConfig
    goal_link_timeout: float
    result_timeout: int
    executor: str


def check(values: Mapping[str, Any]) -> Settings:
    """Settings of parameter values, one for each of `PARAMETERS`.

    Raises:
        ValueError: a value makes no sense; the text says which and why.
    """
    for name, value in values.items():
        _check_one(_BY_NAME[name], value)
    link = {p.link_field: values[p.name] for p in PARAMETERS if p.link_field}
    if values["executor"] not in EXECUTORS:
        raise ValueError(f"executor {values['executor']!r} is not one of {list(EXECUTORS)}")
    return Settings(
        link=LinkConfig(**link, request_timeout=values["poll_timeout"] / 1000),
        goal_link_timeout=float(values["goal_link_timeout"]),
        result_timeout=values["result_timeout"],
        executor=values["executor"],
    )


def _check_one(parameter: Parameter, value: Any) -> None:
    """What rclpy lets through because the type is open: floats."""
    if not isinstance(parameter.default, float):
        return
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{parameter.name} must be a number, not {value!r}")
    if not parameter.low <= value <= parameter.high:  # nor is NaN
        raise ValueError(
            f"{parameter.name} must be in {parameter.low:g}..{parameter.high:g}, not {value:g}"
        )


def markdown() -> str:
    """The table of parameters in Markdown, as the README shows it."""
    rows = ["| Parameter | Default | Range | Meaning |", "| --- | --- | --- | --- |"]
    for p in PARAMETERS:
        limits = "" if isinstance(p.default, str) else f"{p.low:g} to {p.high:g}"
        if isinstance(p.default, int):
            limits = f"{int(p.low)} to {int(p.high)}"
        note = "; at the start only" if p.fixed else ""
        rows.append(f"| `{p.name}` | `{p.default}` | {limits} | {p.description}{note} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(markdown())
