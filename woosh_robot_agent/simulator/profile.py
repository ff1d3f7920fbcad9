"""Profiles: how a robot of one model behaves. They are read from YAML files.

The shipped profiles are in the folder `data/profiles/`. Their comments describe the keys.
"""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.simulator.status_codes import Language
from woosh_robot_agent.simulator.yaml_fields import DataFileError, Node, parse

STARTING_STATES = ("kInit", "kReady")
"""States of a task before it is executed, by name."""


class Spread(NamedTuple):
    """A distribution of times, in seconds. In a file it is a list of these three numbers.

    Attributes:
        median: Median.
        usual: 90 % quantile.
        longest: Maximum.
    """

    median: float
    usual: float
    longest: float

    def at(self, share: float) -> float:
        """Return the quantile of the times at `share`, from 0 to 1."""
        if share <= 0.5:
            return self.median * (0.9 + 0.2 * share)
        if share <= 0.9:
            return self.median + (self.usual - self.median) * (share - 0.5) / 0.4
        # Times near the maximum are rare.
        return self.usual + (self.longest - self.usual) * ((share - 0.9) / 0.1) ** 30


class Range(NamedTuple):
    """A range of equally likely times, in seconds. In a file it is a list of these two numbers.

    Attributes:
        least: Minimum.
        most: Maximum.
    """

    least: float
    most: float

    def at(self, share: float) -> float:
        """Return the quantile of the times at `share`, from 0 to 1."""
        return self.least + (self.most - self.least) * share


class Corner(NamedTuple):
    """A corner of the robot in the frame of its base, in metres. In a file it is a list: [x, y]."""

    x: float
    y: float


@dataclass(frozen=True)
class ModelProfile:
    """Model and sizes.

    Attributes:
        display_model: Name for people.
        urdf_name: Name of the robot's description.
        length: Reported length, in millimetres.
        width: Reported width, in millimetres.
        height: Reported height, in millimetres.
        weight: Reported weight, in kg.
        load: Reported maximum load, in kg.
        outline: Corners of the real outline on the floor.
    """

    display_model: str
    urdf_name: str
    length: int
    width: int
    height: int
    weight: int
    load: int
    outline: tuple[Corner, ...]

    def __post_init__(self) -> None:
        if len(self.outline) < 3:
            raise ValueError(f"outline has {len(self.outline)} corners, less than 3")


@dataclass(frozen=True)
class TaskProfile:
    """Tasks: the steps that they have, and the times between their reports.

    Attributes:
        starting_states: States reported before the task is executed, in order.
        first_report: Possible times from the answer to the first report, in seconds, all equally
            likely; empty for the next step of the simulation.
        between_jobs: Time from the end of a job to the start of the next one, in seconds.
        order_effect: Time from an order to the report that shows its effect.
        state_first: Share of the tasks, from 0 to 1, for which RobotState is pushed before the
            answer.
        empty_report: Time from the end of a task to an empty report; None to keep the last one.
        report_last_action: The last state of an action is reported before that of its task.
        final_wait: A pick task ends with a wait of 0 s.
        leave_dock: A robot in a dock leaves it before it drives to another place.
        pause_at_obstacle: A task that an obstacle blocks is reported as paused.
        obstacle_timeout: Time after which a task without a way round an obstacle fails, in
            seconds; None to wait without a timeout.
        charge_as_parking: The robot's state is kParking while it drives to a charger by itself.
        messages: Reports have texts.
        own_id_factor: Factor in the ids that the robot chooses: Unix time in seconds * factor +
            offset.
        own_id_offset: Offset in these ids.
    """

    starting_states: tuple[str, ...]
    first_report: tuple[float, ...]
    between_jobs: float
    order_effect: Spread
    state_first: float
    empty_report: Range | None
    report_last_action: bool
    final_wait: bool
    leave_dock: bool
    pause_at_obstacle: bool
    obstacle_timeout: float | None
    charge_as_parking: bool
    messages: bool
    own_id_factor: int
    own_id_offset: int

    def __post_init__(self) -> None:
        if self.state_first > 1.0:
            raise ValueError(f"state_first must be at most 1, not {self.state_first:g}")
        for name in self.starting_states:
            if name not in STARTING_STATES:
                raise ValueError(
                    f"starting_states: {name!r} is not one of {', '.join(STARTING_STATES)}"
                )


@dataclass(frozen=True)
class AnswerProfile:
    """Times from a request to its answer.

    Attributes:
        default: Times of all requests that are not in `requests`.
        requests: Times by the full name of the request.
        initialisation: Time that InitRobot takes, during which the robot is not initialised.
    """

    default: Spread
    requests: Mapping[str, Spread]
    initialisation: Range

    def __post_init__(self) -> None:
        for name in self.requests:
            try:
                message_type(name)
            except KeyError:
                raise ValueError(f"requests: there is no such request: {name}") from None


@dataclass(frozen=True)
class MappingProfile:
    """Making maps.

    Attributes:
        start: Time from BuildMap that starts to its answer.
        state_after: Time from this request until the state is kMapping, in seconds.
        picture_period: Time between two pictures of the map that is being made, in seconds.
        save: Time from BuildMap that saves to its answer, from which on the robot is not
            initialised.
        scene_after: Time from this request until the new map is the current one, in seconds.
        cancel: Time from BuildMap that cancels to its answer, from which on the robot is not
            initialised.
    """

    start: Range
    state_after: float
    picture_period: float
    save: Spread
    scene_after: float
    cancel: Range

    def __post_init__(self) -> None:
        if not self.picture_period:
            raise ValueError("picture_period must be more than 0")


@dataclass(frozen=True)
class RateProfile:
    """Rates of reports.

    Attributes:
        pose_speed: Time between two reports of a moving robot, in seconds; 0 for each step of the
            simulation.
        scan: Time between two scans of the laser, in seconds.
        scan_push: Time between two scans that are pushed, in seconds.
        battery: Time after which an unchanged battery is reported again; None for never.
        operation: Time after which the statistics of the day are reported again although the robot
            has not driven, in seconds; None for never.
    """

    pose_speed: float
    scan: float
    scan_push: float
    battery: Range | None
    operation: float | None


@dataclass(frozen=True)
class DrivingProfile:
    """Remote control.

    Attributes:
        start_delay: Time from the first velocity to the first motion, in seconds.
        rolls_for: Time constant of the exponential slowdown after a velocity of zero, in seconds;
            0 to stop at once.
        stops_below: Speed at which the base stands after a slowdown, in m/s or rad/s.
    """

    start_delay: float
    rolls_for: float
    stops_below: float


@dataclass(frozen=True)
class BatteryProfile:
    """The battery.

    Attributes:
        idle_drain: Discharge with time, in percent per second.
        driving_drain: Discharge with distance, in percent per metre.
        charging_rate: Charge with time at a charger, in percent per second.
        health: Remaining capacity, as reported.
        charge_cycle: Number of charge cycles.
        battery_cycle: Number of charge cycles for which the battery is rated.
        temp_max: Maximum temperature of the cells, in degrees Celsius.
    """

    idle_drain: float
    driving_drain: float
    charging_rate: float
    health: int
    charge_cycle: int
    battery_cycle: int
    temp_max: int


@dataclass(frozen=True)
class ChargingProfile:
    """Docking, and charge tasks.

    Attributes:
        docking_distance: Distance before a mark at which docking starts, in metres.
        docking_speed: Speed of docking, in m/s.
        steps: Distances of the steps into a charger after docking, in metres.
        step_speed: Speed of these steps, in m/s.
        starts_after: Time from the start of the charging job until current flows, in seconds.
        confirmed_after: Time from the start of the job to its end, in seconds. The battery goes on
            charging. None to end the job when the battery is full.
        completed_after: Time from the end of the job to the end of the task, in seconds.
    """

    docking_distance: float
    docking_speed: float
    steps: tuple[float, ...]
    step_speed: float
    starts_after: float
    confirmed_after: float | None
    completed_after: float


@dataclass(frozen=True)
class RefusalProfile:
    """Refused requests.

    Attributes:
        explained: Answers explain a refusal, instead of using the words of the real robot.
        codes: A status code follows the answer where the real robot sends one.
        while_busy: True to refuse a task while another one runs, steps while other steps run, and
            InitRobot while a task runs. False to replace what is running.
    """

    explained: bool
    codes: bool
    while_busy: bool


@dataclass(frozen=True)
class StatusCodeProfile:
    """Status codes.

    Attributes:
        language: Language of their texts.
    """

    language: Language


@dataclass(frozen=True)
class Profile:
    """How a robot of one model behaves.

    Attributes:
        name: Name of the file without its suffix.
        model: Model and sizes.
        tasks: Tasks.
        answers: Answers.
        mapping: Making maps.
        rates: Rates of reports.
        driving: Remote control.
        battery: Battery.
        charging: Charge tasks.
        refusals: Refused requests.
        status_codes: Status codes.
    """

    name: str
    model: ModelProfile
    tasks: TaskProfile
    answers: AnswerProfile
    mapping: MappingProfile
    rates: RateProfile
    driving: DrivingProfile
    battery: BatteryProfile
    charging: ChargingProfile
    refusals: RefusalProfile
    status_codes: StatusCodeProfile


SHIPPED_FOLDER = Path(__file__).parent / "data" / "profiles"
"""Folder of the shipped profiles."""

SHIPPED = tuple(sorted(path.stem for path in SHIPPED_FOLDER.glob("*.yaml")))
"""Names of the shipped profiles."""

_MAX_ITEMS = 100
"""Maximum number of items of a list."""

_MAX_INTEGER = 2**31 - 1

_T = TypeVar("_T")


def load_profile(source: str | Path | Profile) -> Profile:
    """Return a profile.

    Args:
        source: Name of a shipped profile, path of a file, or a profile, which is returned.

    Raises:
        DataFileError: There is no such profile, or its file cannot be used.
    """
    if isinstance(source, Profile):
        return source
    if str(source) in SHIPPED:
        return _shipped(str(source))
    return _read(Path(source))


@lru_cache
def _shipped(name: str) -> Profile:
    return _read(SHIPPED_FOLDER / f"{name}.yaml")


def _read(path: Path) -> Profile:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataFileError(
            f"profile {path}: {error.strerror or error}; give a YAML file, or one of "
            + ", ".join(SHIPPED)
        ) from error
    found: Profile = _section(parse(path.name, data), Profile, name=path.stem)
    return found


def _section(node: Node, kind: type[_T], **given: Any) -> _T:
    """Return a section of the file as an object of the dataclass `kind`.

    Args:
        node: The section, with exactly the attributes of the dataclass as keys.
        kind: The dataclass.
        given: Attributes that are not in the file.
    """
    hints = get_type_hints(kind)
    names = [
        field.name
        for field in dataclasses.fields(kind)  # type: ignore[arg-type]
        if field.name not in given
    ]
    node.check_keys(names)
    values = {name: _value(node, name, hints[name]) for name in names}
    try:
        return kind(**given, **values)
    except ValueError as error:
        raise node.error(str(error)) from None


def _value(section: Node, name: str, kind: Any) -> Any:
    """Return the value of a key, converted to its type."""
    if get_origin(kind) is types.UnionType:
        if name in section.value and section.value[name] is None:
            return None
        kind = next(each for each in get_args(kind) if each is not type(None))
    return _converted(section.required(name), kind)


def _converted(node: Node, kind: Any) -> Any:
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _section(node, kind)
    if kind is Corner:
        return Corner(*node.numbers("x, y"))
    if kind in (Spread, Range):
        numbers = [_converted(item, float) for item in node.items(len(kind._fields))]
        if len(numbers) < len(kind._fields) or numbers != sorted(numbers):
            raise node.error(f"must be [{', '.join(kind._fields)}], not {node.preview()}")
        return kind(*numbers)
    if get_origin(kind) is tuple:
        return tuple(_converted(item, get_args(kind)[0]) for item in node.items(_MAX_ITEMS))
    if get_origin(kind) is Mapping:
        node.check_keys([key for key in node.value if isinstance(key, str)] if node.value else [])
        return {key: _converted(node.required(key), get_args(kind)[1]) for key in node.value}
    if get_origin(kind) is Literal:
        if node.value not in get_args(kind):
            raise node.error(f"must be one of {', '.join(get_args(kind))}, not {node.preview()}")
        return node.value
    if kind is bool:
        if not isinstance(node.value, bool):
            raise node.error(f"must be true or false, not {node.preview()}")
        return node.value
    if kind is str:
        return node.text()
    if kind is int:
        return node.integer(0, _MAX_INTEGER)
    number = node.number()
    if number < 0.0:
        raise node.error(f"must not be negative, but is {node.preview()}")
    return number
