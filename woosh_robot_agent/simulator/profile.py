"""Profiles: the behaviour of one robot model, e.g. answer times and speeds, read from YAML files.

The shipped profiles are in the folder `data/profiles/`. The comments in `tr200.yaml` describe each
key, with its unit; docs/simulator_reference.md has them as a table.
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
    """Section `tasks`: what tasks do, and how and when their reports show it."""

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
    """Section `answers`: times from a request to its answer."""

    default: RisingDistribution
    requests: Annotated[Mapping[str, RisingDistribution], _check_requests]
    initialisation: RisingInterval


@dataclass(frozen=True)
class MappingProfile:
    """Section `mapping`: times of making a map, from the request BuildMap on."""

    start: RisingInterval
    state_after: NotNegative
    picture_period: Annotated[float, Between(0.001)]
    save: RisingDistribution
    scene_after: NotNegative
    cancel: RisingInterval


@dataclass(frozen=True)
class RateProfile:
    """Section `rates`: periods of scans and of pushed reports."""

    pose_speed: NotNegative
    scan: NotNegative
    scan_push: NotNegative
    battery: RisingInterval | None


@dataclass(frozen=True)
class DrivingProfile:
    """Section `driving`: limits of the speed, turn rates in rad/s, and remote control."""

    max_speed: Annotated[float, Between(0.01, 10.0)]
    max_turn_rate: Annotated[float, Between(0.01, 20.0)]
    start_delay: NotNegative
    rolls_for: NotNegative
    stops_below: NotNegative


@dataclass(frozen=True)
class BatteryProfile:
    """Section `battery`: rates, and values of Battery that never change."""

    idle_drain: NotNegative
    driving_drain: NotNegative
    charging_rate: NotNegative
    health: Count
    charge_cycle: Count
    battery_cycle: Count
    temp_max: Count


@dataclass(frozen=True)
class ChargingProfile:
    """Section `charging`: docking, and charge tasks."""

    docking_distance: NotNegative
    docking_speed: Annotated[float, Between(0.001)]
    starts_after: NotNegative
    confirmed_after: NotNegative | None
    completed_after: NotNegative


@dataclass(frozen=True)
class RefusalProfile:
    """Section `refusals`: which requests are refused, and how."""

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
