"""Profiles: the behaviour of one robot model, e.g. answer times and speeds, read from YAML files.

The shipped profiles are in the folder `data/profiles/`. The comments in `tr200.yaml` describe each
key in more detail; docs/simulator_reference.md has them as a table. Unless a class names other
units, all times are in seconds, distances in metres and speeds in m/s.
"""

from __future__ import annotations

import random
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
    source_field,
    structure,
)
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.simulator.status_codes import Language
from woosh_robot_agent.simulator.world.laser import Laser


class Distribution(NamedTuple):
    """Times of which half are at most `median`, 90 % at most `usual`, and all at most `longest`.

    In a file it is a list: [median, usual, longest].
    """

    median: float
    usual: float
    longest: float

    def sample(self, rng: random.Random) -> float:
        """Return a random time."""
        share = rng.random()
        if share <= 0.5:
            # The profile gives no minimum: take 90 % of the median.
            return self.median * (0.9 + 0.2 * share)
        if share <= 0.9:
            return self.median + (self.usual - self.median) * (share - 0.5) / 0.4
        # Times near the maximum are rare.
        return self.usual + (self.longest - self.usual) * ((share - 0.9) / 0.1) ** 30


class Interval(NamedTuple):
    """Uniformly distributed times. In a file it is a list: [least, most]."""

    least: float
    most: float

    def sample(self, rng: random.Random) -> float:
        """Return a random time."""
        return rng.uniform(self.least, self.most)


class Corner(NamedTuple):
    """A corner of the robot in the frame of its base, in metres. In a file it is a list: [x, y]."""

    x: float
    y: float


def _check_rising(times: Distribution | Interval) -> None:
    """Raise ValueError if a time is negative, or shorter than the one before."""
    if times[0] < 0.0 or list(times) != sorted(times):
        shape = ", ".join(times._fields)
        raise ValueError(f"must be [{shape}], each at least as long as the one before")


def _check_requests(requests: Mapping[str, object]) -> None:
    """Raise ValueError if a key is not the full name of a protobuf message."""
    for name in requests:
        try:
            message_type(name)
        except KeyError:
            raise ValueError(f"there is no such request: {name}") from None


RisingDistribution = Annotated[Distribution, _check_rising]
RisingInterval = Annotated[Interval, _check_rising]
Share = Annotated[float, Between(0.0, 1.0)]
Count = Annotated[int, Between(0, 2**31 - 1)]


@dataclass(frozen=True)
class ModelProfile:
    """Section `model`: sizes in millimetres, weight and load in kilograms, outline in metres."""

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
    """Section `tasks`: what tasks do, and how and when their reports show it.

    Attributes:
        starting_states: states that are reported before a task is executed.
        first_report: times from the answer to the first report of a task, one chosen at random;
            empty to report in the steps after the answer.
        between_jobs: time from the end of an action of a task to the start of the next one.
        order_effect: time from an ActionOrder to the report that shows its effect.
        state_first: probability that RobotState is pushed before the answer to a request.
        empty_report: time from the last report of a task to the report that there is no task; None
            if there is no such report.
        report_last_action: True to report the end of a task's last action before that of the task.
        final_wait: True to do waits of 0 s, e.g. the one at the end of a pick task, too.
        leave_dock: True if a robot that stands at a charger leaves its dock before a task.
        next_after_cancel: True if a client's cancel of a task that is not paused ends only this
            task, so that its set goes on; False if it ends the set.
        pause_at_obstacle: True to report a task before an obstacle as paused.
        obstacle_timeout: time after which an obstacle makes a task fail; None for never.
        charge_as_parking: True to report `kParking` on the way to a charger that the robot has
            chosen itself.
        messages: True if reports have texts for people.
        own_id_factor: an id that the robot chooses for a task is the Unix time in seconds times
            this factor, plus `own_id_offset`.
        own_id_offset: see `own_id_factor`.
    """

    starting_states: tuple[Literal["kInit", "kReady"], ...]
    first_report: tuple[NotNegative, ...]
    between_jobs: NotNegative
    order_effect: RisingDistribution
    state_first: Share
    empty_report: RisingInterval | None
    report_last_action: bool
    final_wait: bool
    leave_dock: bool
    next_after_cancel: bool
    pause_at_obstacle: bool
    obstacle_timeout: NotNegative | None
    charge_as_parking: bool
    messages: bool
    own_id_factor: Count
    own_id_offset: Count


@dataclass(frozen=True)
class AnswerProfile:
    """Section `answers`: times from a request to its answer.

    Attributes:
        default: time for all requests that are not in `requests`.
        requests: times for other requests, by message type.
        initialisation: time for InitRobot, during which the robot is not initialised.
    """

    default: RisingDistribution
    requests: Annotated[Mapping[str, RisingDistribution], _check_requests]
    initialisation: RisingInterval


@dataclass(frozen=True)
class MappingProfile:
    """Section `mapping`: times of making a map, from the request BuildMap on.

    Attributes:
        start: until the answer to the request that begins a map.
        state_after: until the state of the robot shows the mapping.
        picture_period: time between two pushed pictures of the map.
        save: until the answer to the request that saves the map.
        scene_after: until the saved map is the current one.
        cancel: until the answer to the request that discards the map.
    """

    start: RisingInterval
    state_after: NotNegative
    picture_period: Annotated[float, Between(0.001)]
    save: RisingDistribution
    scene_after: NotNegative
    cancel: RisingInterval


@dataclass(frozen=True)
class RateProfile:
    """Section `rates`: periods of scans and of pushed reports.

    Attributes:
        pose_speed: minimum time between two PoseSpeed of a moving robot.
        scan: time between two scans of the laser.
        scan_push: minimum time between two scans that are pushed.
        battery: time until an unchanged Battery is pushed again; None for never.
        operation: time until the record of the day is pushed again although the robot has not
            driven; None for never.
    """

    pose_speed: NotNegative
    scan: NotNegative
    scan_push: NotNegative
    battery: RisingInterval | None
    operation: NotNegative | None


@dataclass(frozen=True)
class DrivingProfile:
    """Section `driving`: limits of the speed, turn rates in rad/s, and remote control.

    Attributes:
        max_speed: maximum speed.
        max_turn_rate: maximum turn rate.
        start_delay: time from the first velocity command to the first motion of a standing robot.
        rolls_for: time constant of the exponential slowdown after remote control; 0 for none.
        stops_below: speed, or turn rate, at which this slowdown ends.
    """

    max_speed: Annotated[float, Between(0.01, 10.0)]
    max_turn_rate: Annotated[float, Between(0.01, 20.0)]
    start_delay: NotNegative
    rolls_for: NotNegative
    stops_below: NotNegative


@dataclass(frozen=True)
class BatteryProfile:
    """Section `battery`: rates, and values of Battery that never change.

    Attributes:
        idle_drain: discharge, in percent per second.
        driving_drain: additional discharge, in percent per metre.
        charging_rate: charge at a charger, in percent per second.
        health: value that is reported.
        charge_cycle: value that is reported.
        battery_cycle: value that is reported.
        temp_max: temperature that is reported, in degrees Celsius.
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
    """Section `charging`: docking, and charge tasks.

    Attributes:
        docking_distance: distance before a mark at which docking starts.
        docking_speed: speed of docking.
        starts_after: time from the start of the action that charges to the flow of current.
        confirmed_after: time from the start of this action to its end, after which the battery goes
            on charging; None if the action ends when the battery is full.
        completed_after: time from the end of this action to the end of the task.
    """

    docking_distance: NotNegative
    docking_speed: Annotated[float, Between(0.001)]
    starts_after: NotNegative
    confirmed_after: NotNegative | None
    completed_after: NotNegative


@dataclass(frozen=True)
class RefusalProfile:
    """Section `refusals`: which requests are refused, and how.

    Attributes:
        always: texts of the answers to requests that are always refused, by message type.
        texts: texts of all other refusals of a request, by message type. Types that are not listed
            have the words for the reason, `Refusal.words`.
        explained: True to answer with explanations for people instead of these texts.
        codes: True if a status code follows a refusal for which the real robot has one.
        while_busy: True to refuse a task or steps while others run, and InitRobot while a task
            runs; False to replace what runs.
    """

    always: Annotated[Mapping[str, str], _check_requests]
    texts: Annotated[Mapping[str, str], _check_requests]
    explained: bool
    codes: bool
    while_busy: bool


@dataclass(frozen=True)
class StatusCodeProfile:
    """Section `status_codes`: their texts."""

    language: Language


@dataclass(frozen=True)
class Profile:
    """The behaviour of one robot model: the sections of a profile file."""

    model: ModelProfile
    tasks: TaskProfile
    answers: AnswerProfile
    mapping: MappingProfile
    rates: RateProfile
    laser: Laser
    driving: DrivingProfile
    battery: BatteryProfile
    charging: ChargingProfile
    refusals: RefusalProfile
    status_codes: StatusCodeProfile
    file: str = source_field()
    """Name of the file that the profile was read from; not a key of the file."""

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
        source: name of a shipped profile, path of a YAML file, or a profile, which is returned.

    Raises:
        DataFileError: there is no such profile, or its file cannot be used.
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
    """Read a profile from a file; raise DataFileError if it is unreadable or no profile."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataFileError(
            f"profile {path}: {error.strerror or error}; give a YAML file, or one of "
            + ", ".join(SHIPPED)
        ) from error
    return structure(Profile, load_yaml(path.name, data), path.name)
