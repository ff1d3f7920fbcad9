"""The parameters of the agent: name, default, range and meaning, and their checked values.

`python3 -m woosh_robot_agent.parameters` prints the table in Markdown, with `--yaml` as a parameter
file.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.motion import MAX_VELOCITY, VelocityLimits


@dataclass(frozen=True)
class Parameter:
    """A parameter of the agent.

    Attributes:
        default: default, which also determines the type. A tuple of numbers is an array of that
            length, a tuple of strings an array of any number of names.
        description: meaning and unit, one sentence.
        low, high: range of a number or of each number of an array, both ends included; without
            meaning for texts and booleans.
        read_only: True if it can be set only at start-up.
    """

    name: str
    default: str | bool | int | float | tuple[float, ...] | tuple[str, ...]
    description: str
    low: float = 0
    high: float = 0
    read_only: bool = False

    @property
    def initial(self) -> Any:
        """The default in the form that rclpy takes."""
        return list(self.default) if isinstance(self.default, tuple) else self.default

    @property
    def holds_names(self) -> bool:
        """True if the parameter is an array of names."""
        return isinstance(self.default, tuple) and isinstance(self.default[0], str)

    @property
    def shown(self) -> str:
        """The default as documentation shows it."""
        if isinstance(self.default, bool):
            return str(self.default).lower()
        if isinstance(self.default, tuple):
            return json.dumps(self.default)
        return str(self.default)

    @property
    def limits(self) -> str:
        """The range as documentation shows it; empty if there is none."""
        if isinstance(self.default, str | bool) or self.holds_names:
            return ""
        if isinstance(self.default, int):
            return f"{int(self.low)} to {int(self.high)}"
        return f"{self.low:g} to {self.high:g}"

    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor, which tools such as `ros2 param describe` show."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=self.read_only,
            # accept an integer for a floating-point number
            dynamic_typing=isinstance(self.default, float | tuple) and not self.holds_names,
        )
        if isinstance(self.default, bool):  # a bool is an int, too, but has no range
            return descriptor
        if isinstance(self.default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)
            ]
        elif isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(self.low), to_value=float(self.high), step=0.0)
            ]
        return descriptor

    def check(self, value: Any) -> None:
        """Check a value that rclpy does not check because of dynamic typing.

        Raises:
            ValueError: the value is invalid; the text says which one and why.
        """
        if isinstance(self.default, float):
            self._check_number(value)
        elif isinstance(self.default, tuple) and not self.holds_names:
            # rclpy gives a list, an `array.array` or an array of numpy, which is no Sequence
            if not isinstance(value, Sequence) and not hasattr(value, "tolist"):
                raise ValueError(f"{self.name} must be a list of numbers, not {value!r}")
            if len(value) != len(self.default):
                raise ValueError(f"{self.name} must have {len(self.default)} numbers")
            for number in value:
                self._check_number(number)

    def _check_number(self, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{self.name} must be a number, not {value!r}")
        if not self.low <= value <= self.high or math.isinf(value):  # also refuses NaN
            raise ValueError(
                f"{self.name} must be from {self.low:g} to {self.high:g}, not {value:g}"
            )


def parameter_field(
    default: Any, description: str, low: float = 0, high: float = 0, *, read_only: bool = False
) -> Any:
    """Return a dataclass field that declares the parameter of the same name.

    The arguments are attributes of `Parameter`.
    """
    # `parameters_of` sets the name
    parameter = Parameter("", default, description, low, high, read_only)
    return dataclasses.field(default=default, metadata={"parameter": parameter})


def parameters_of(settings_class: Any) -> tuple[Parameter, ...]:
    """Return the parameters that a dataclass declares with `parameter_field`, in order."""
    return tuple(
        dataclasses.replace(each.metadata["parameter"], name=each.name)
        for each in dataclasses.fields(settings_class)
        if each.metadata
    )


PARTS = (
    "battery_state",
    "cmd_vel",
    "connected",
    "diagnostics",
    "footprint",
    "goal_pose",
    "initialpose",
    "map",
    "odom",
    "plan",
    "scan",
    "stop",
)
"""Parts of the standard layer (the standard topics and services) that `disabled_parts` can switch
off. /tf has a parameter of its own, `publish_tf`."""


@dataclass(frozen=True)
class StandardSettings:
    """The values of the standard layer's parameters; each field has a description.

    Raises:
        ValueError: the name of a frame or a part is invalid.
    """

    disabled_parts: tuple[str, ...] = parameter_field(
        ("",),
        f"Standard topics and services that are switched off, any of {', '.join(PARTS)}.",
        read_only=True,
    )
    publish_tf: bool = parameter_field(
        False, "Publish map -> odom -> base_link on /tf.", read_only=True
    )
    publish_laser_tf: bool = parameter_field(
        True,
        "With publish_tf, publish base_link -> laser on /tf_static if the firmware reports it; set "
        "it to false if a URDF defines that transform.",
        read_only=True,
    )

    frame_prefix: str = parameter_field(
        "", "Prefix of all frame names, e.g. robot1/.", read_only=True
    )
    map_frame: str = parameter_field("map", "Frame of the chassis's map.", read_only=True)
    odom_frame: str = parameter_field(
        "odom", "Frame in which the robot's pose never jumps.", read_only=True
    )
    base_frame: str = parameter_field("base_link", "Frame of the robot.", read_only=True)
    scan_frame: str = parameter_field("laser", "Frame of the laser.", read_only=True)

    odom_rate: float = parameter_field(
        20.0, "Rate of odom, in Hz. If odom_prediction is false, its highest rate.", 0.1, 200.0
    )
    odom_prediction: bool = parameter_field(
        True,
        "Predict odom between the reports of a moving robot; false publishes each report once.",
    )
    pose_covariance: tuple[float, ...] = parameter_field(
        (0.0025, 0.0025, 1e6, 1e6, 1e6, 0.0076),
        "Diagonal of the pose covariance in odom: x, y, z in m^2, roll, pitch, yaw in rad^2.",
        0.0,
        1e12,
    )
    twist_covariance: tuple[float, ...] = parameter_field(
        (0.0025, 0.0025, 1e6, 1e6, 1e6, 0.0076),
        "Diagonal of the twist covariance in odom: x, y, z in (m/s)^2, roll, pitch, yaw in "
        "(rad/s)^2.",
        0.0,
        1e12,
    )
    scan_rate: float = parameter_field(
        10.0, "Rate at which scans are requested and published, in Hz.", 0.1, 50.0
    )

    cmd_vel_stamped: bool = parameter_field(
        False, "Subscribe to cmd_vel as TwistStamped instead of Twist.", read_only=True
    )
    cmd_vel_rate: float = parameter_field(
        20.0, "Maximum rate of velocity commands sent to the chassis, in Hz.", 1.0, 100.0
    )
    cmd_vel_timeout: float = parameter_field(
        0.5,
        "Time without a message on cmd_vel after which the robot is stopped, in seconds.",
        0.05,
        5.0,
    )
    cmd_vel_max_age: float = parameter_field(
        0.5,
        "Maximum age of a velocity when it is sent (never more than 0.5), and maximum difference "
        "of a TwistStamped's stamp from now, in seconds; 0 accepts any stamp.",
        0.0,
        60.0,
    )
    cmd_vel_max_linear: float = parameter_field(
        1.0,
        "Maximum linear speed, in m/s; cmd_vel and robot/Twist are clamped to it.",
        0.0,
        MAX_VELOCITY,
    )
    cmd_vel_max_angular: float = parameter_field(
        1.0,
        "Maximum angular speed, in rad/s; cmd_vel and robot/Twist are clamped to it.",
        0.0,
        MAX_VELOCITY,
    )
    cmd_vel_override: bool = parameter_field(
        False, "Accept cmd_vel even while a goal or another client's task is running."
    )

    def __post_init__(self) -> None:
        for name in ("frame_prefix", "map_frame", "odom_frame", "base_frame", "scan_frame"):
            frame = getattr(self, name)
            if frame.startswith("/"):
                raise ValueError(f"{name} must not begin with a slash: {frame!r}")
            if not frame and name != "frame_prefix":
                raise ValueError(f"{name} must not be empty")
        # the default is [""], because ROS cannot tell the type of an empty list
        if unknown := set(self.disabled_parts) - {*PARTS, ""}:
            raise ValueError(
                f"disabled_parts has no part {', '.join(sorted(unknown))!r}; the parts are "
                f"{', '.join(PARTS)}"
            )

    def enables(self, part: str) -> bool:
        """Return True if a part of the standard layer is on: one of `PARTS`, or `tf`."""
        return self.publish_tf if part == "tf" else part not in self.disabled_parts

    @cached_property
    def velocity_limits(self) -> VelocityLimits:
        """Limits of cmd_vel; the limits of the speed also hold for robot/Twist."""
        return VelocityLimits(
            max_linear=self.cmd_vel_max_linear,
            max_angular=self.cmd_vel_max_angular,
            rate=self.cmd_vel_rate,
            timeout=self.cmd_vel_timeout,
            override=self.cmd_vel_override,
            max_age=self.cmd_vel_max_age or math.inf,  # 0 accepts any stamp
        )


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
        "Id of the robot in queries, for a gateway; 0 sends no id. Velocities carry no id: a "
        "gateway needs a port for each robot.",
        0,
        2**32 - 1,
    ),
    _link(
        "connect_timeout",
        "Timeout for opening the connection, and again for the first RobotInfo, with which the "
        "link becomes ready, in seconds.",
        0.1,
        60.0,
    ),
    _link(
        "liveness_timeout",
        "Time without a sign of life from the chassis after which the link counts as lost, in "
        "seconds.",
        0.5,
        600.0,
    ),
    _link("max_frame_size", "Maximum size of a frame from the chassis, in bytes.", 1024, 2**31 - 1),
)


@dataclass(frozen=True)
class Settings:
    """The checked values of all parameters; `standard` has those of the standard layer."""

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
        "Time that the result of an ended goal stays available to clients, in seconds. Of each "
        "action, only the last 100 results are kept.",
        1,
        86400,
        read_only=True,
    )
    nav2: bool = parameter_field(
        False,
        "Offer Nav2's actions, services and topics, for programs written for Nav2; not beside a "
        "Nav2 that drives the robot.",
        read_only=True,
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
_GONE = {
    **{f"enable_{part}": f'list it in disabled_parts: ["{part}"]' for part in PARTS},
    "handshake_timeout": "set connect_timeout, which holds for both steps",
    **dict.fromkeys(
        (
            "close_timeout",
            "backoff_min",
            "backoff_max",
            "stable_after",
            "max_in_flight",
            "push_queue",
        ),
        "its value is fixed",
    ),
    "executor": "the agent has one executor for all releases and middleware",
}
"""Parameters that do not exist any more, and what to do instead."""


def check_names(names: Iterable[str]) -> list[str]:
    """Check the names of parameters that a user has set.

    Returns:
        A warning for each name that looks misspelt. All other names may belong to other nodes that
        share the parameter file.

    Raises:
        ValueError: a parameter does not exist any more.
    """
    warnings = []
    for name in names:
        if name in _GONE:
            raise ValueError(f"there is no parameter {name}: {_GONE[name]}")
        if name not in _BY_NAME and (
            similar := difflib.get_close_matches(name, _BY_NAME, n=1, cutoff=0.8)
        ):
            warnings.append(
                f"there is no parameter {name}, and setting it has no effect; did you mean "
                f"{similar[0]}?"
            )
    return warnings


def settings_from(values: Mapping[str, Any]) -> Settings:
    """Return the settings for parameter values, one value for each of `PARAMETERS`.

    Raises:
        ValueError: a value is invalid; the text says which one and why.
    """
    for name, value in values.items():
        _BY_NAME[name].check(value)
    own = {parameter.name: values[parameter.name] for parameter in _OWN_PARAMETERS}
    own["robots"] = _names(own["robots"])
    standard = {parameter.name: values[parameter.name] for parameter in _STANDARD_PARAMETERS}
    standard["disabled_parts"] = _names(standard["disabled_parts"])
    return Settings(
        link=LinkConfig(
            **{parameter.name: values[parameter.name] for parameter in _LINK_PARAMETERS},
            handshake_timeout=values["connect_timeout"],
            request_timeout=values["poll_timeout"] / 1000,
        ),
        standard=StandardSettings(**standard),
        **own,
    )


def _names(value: Sequence[str]) -> tuple[str, ...]:
    """Return the names in an array; in parameter files, `[""]` stands for an empty array."""
    return () if list(value) == [""] else tuple(value)


def markdown() -> str:
    """Return the table of parameters in Markdown."""
    rows = ["| Parameter | Default (range) | Meaning |", "| --- | --- | --- |"]
    for p in PARAMETERS:
        limits = f" ({p.limits})" if p.limits else ""
        note = " Read-only." if p.read_only else ""
        rows.append(f"| `{p.name}` | `{p.shown}`{limits} | {p.description}{note} |")
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
