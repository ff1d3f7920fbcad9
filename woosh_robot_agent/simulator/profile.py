"""Profiles: how a robot of one model behaves. They are read from YAML files.

The shipped profiles are in the folder `data/profiles/`. Their comments describe the keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from woosh_robot_agent.data_files import (
    Between,
    DataFileError,
    NotNegative,
    load_yaml,
    place,
    structure,
)
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.simulator.status_codes import Language


class Distribution(NamedTuple):
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


class Interval(NamedTuple):
    """Equally likely times between two, in seconds. In a file it is a list of these two numbers.

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


def _check_rising(times: Distribution | Interval) -> None:
    if times[0] < 0.0 or list(times) != sorted(times):
        shape = ", ".join(times._fields)
        raise ValueError(f"must be [{shape}], each at least as long as the one before")


def _check_request(times: Mapping[str, Distribution]) -> None:
    for name in times:
        try:
            message_type(name)
        except KeyError:
            raise ValueError(f"there is no such request: {name}") from None


Spread = Annotated[Distribution, _check_rising]
Range = Annotated[Interval, _check_rising]
Share = Annotated[float, Between(0.0, 1.0)]
Count = Annotated[int, Between(0, 2**31 - 1)]


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
    length: Count
    width: Count
    height: Count
    weight: Count
    load: Count
    outline: Annotated[tuple[Corner, ...], Between(3)]


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

    starting_states: tuple[Literal["kInit", "kReady"], ...]
    first_report: tuple[NotNegative, ...]
    between_jobs: NotNegative
    order_effect: Spread
    state_first: Share
    empty_report: Range | None
    report_last_action: bool
    final_wait: bool
    leave_dock: bool
    pause_at_obstacle: bool
    obstacle_timeout: NotNegative | None
    charge_as_parking: bool
    messages: bool
    own_id_factor: Count
    own_id_offset: Count


@dataclass(frozen=True)
class AnswerProfile:
    """Times from a request to its answer.

    Attributes:
        default: Times of all requests that are not in `requests`.
        requests: Times by the full name of the request.
        initialisation: Time that InitRobot takes, during which the robot is not initialised.
    """

    default: Spread
    requests: Annotated[Mapping[str, Spread], _check_request]
    initialisation: Range


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
    state_after: NotNegative
    picture_period: NotNegative
    save: Spread
    scene_after: NotNegative
    cancel: Range

    def __post_init__(self) -> None:
        if self.picture_period == 0.0:
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

    pose_speed: NotNegative
    scan: NotNegative
    scan_push: NotNegative
    battery: Range | None
    operation: NotNegative | None


@dataclass(frozen=True)
class DrivingProfile:
    """Remote control.

    Attributes:
        start_delay: Time from the first velocity to the first motion, in seconds.
        rolls_for: Time constant of the exponential slowdown after a velocity of zero, in seconds;
            0 to stop at once.
        stops_below: Speed at which the base stands after a slowdown, in m/s or rad/s.
    """

    start_delay: NotNegative
    rolls_for: NotNegative
    stops_below: NotNegative


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

    idle_drain: NotNegative
    driving_drain: NotNegative
    charging_rate: NotNegative
    health: Count
    charge_cycle: Count
    battery_cycle: Count
    temp_max: Count


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

    docking_distance: NotNegative
    docking_speed: NotNegative
    steps: tuple[NotNegative, ...]
    step_speed: NotNegative
    starts_after: NotNegative
    confirmed_after: NotNegative | None
    completed_after: NotNegative


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
        file: Name of the file.
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
    file: str = place()

    @property
    def name(self) -> str:
        """Name of the file without its suffix."""
        return Path(self.file).stem


SHIPPED_FOLDER = Path(__file__).parent / "data" / "profiles"
"""Folder of the shipped profiles."""

SHIPPED = tuple(sorted(path.stem for path in SHIPPED_FOLDER.glob("*.yaml")))
"""Names of the shipped profiles."""


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
    return structure(Profile, load_yaml(path.name, data), path.name)
