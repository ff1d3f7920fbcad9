"""Learn a profile of the simulator from the frames of a robot.

Each learned value has its number of samples. Values that the frames do not show are those of the
profile `tr200`.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from woosh_robot_agent.data_files import Between, DataFileError, load_json, load_yaml, structure
from woosh_robot_agent.endpoints import QUERIES
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.link.reports import printable
from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2
from woosh_robot_agent.simulator.profile import SHIPPED_FOLDER, Profile
from woosh_robot_agent.simulator.refusals import REFUSALS, REQUEST_FAILED
from woosh_robot_agent.tools.doctor.observations import (
    Observations,
    SeenFrame,
    codes_in,
    of_busiest_connection,
)
from woosh_robot_agent.tools.options import ToolError

REFERENCE = "tr200"
"""Profile from which values are taken that cannot be learned."""

KeyPath = tuple[str, ...]
"""Keys of a value in a profile, e.g. `("rates", "scan")`."""


class Learned(NamedTuple):
    """A learned value.

    Attributes:
        value: the value, as in the file of a profile.
        samples: number of samples from which the value was learned; 0 if it was not learned, but
            taken from `tr200`.
    """

    value: Any
    samples: int


Values = dict[KeyPath, Learned]
"""Learned values, by their keys in a profile."""


def quantile(values: Sequence[float], share: float) -> float:
    """Return the quantile of some values at `share`, from 0 to 1, interpolated."""
    ordered = sorted(values)
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (place - low)


def learn(seen: Observations) -> Values:
    """Return all values of a profile that can be learned from the observations."""
    learners = (
        _model,
        _first_reports,
        _order_effects,
        _empty_reports,
        _answers,
        _mapping,
        _rates,
        _laser,
        _speeds,
        _start_delays,
        _battery,
        _texts,
    )
    return {path: found for each in learners for path, found in each(seen) if _is_field(path)}


def _is_field(path: KeyPath) -> bool:
    """Return True for the keys of a value that profiles have."""
    return len(path) > 1 and path[1] in reference().get(path[0], {})


_Found = Iterator[tuple[KeyPath, Learned]]
"""Learned values with their keys; each function of `learn` yields some of them."""

_MIN_SAMPLES = 3
"""Minimum number of samples to learn a distribution."""
_MAX_SIZE = 100_000
"""Maximum plausible size in mm, or weight in kg."""


def _model(seen: Observations) -> _Found:
    """Yield names, sizes and outline of the robot's model, from the last General and Model."""
    general, count = seen.latest(robot.General)
    if general:
        for name in ("display_model", "urdf_name"):
            if text := getattr(general, name):
                yield ("model", name), Learned(printable(text), count)
        for each, size in general.model_data.ListFields():
            if size <= _MAX_SIZE:
                yield ("model", each.name), Learned(size, count)
    model, count = seen.latest(robot.Model)
    if model and len(model.model) > 2:
        corners = [[round(each.x, 3), round(each.y, 3)] for each in model.model]
        yield ("model", "outline"), Learned(corners, count)


_ENDED = (task_pb2.kCompleted, task_pb2.kCanceled, task_pb2.kFailed)
_MAX_FIRST_REPORT = 30.0
"""Maximum time from the answer to a task to its first report, in seconds."""
_MAX_EFFECT = 5.0
"""Maximum time from an order to its effect, in seconds."""
_MAX_EMPTY = 0.5
"""Maximum time from the last report of a task to the empty report that follows, which names no
task, in seconds."""
_FIRST_REPORTS = 8
"""Maximum number of values of `tasks.first_report`."""


def _first_reports(seen: Observations) -> _Found:
    """Yield the times from the answer to a task to its first report."""
    reports = seen.pushed(robot.TaskProc)
    times = []
    for each in seen.accepted(pack.ExecTask) + seen.accepted(pack.ExecPreTask):
        if each.request_body is None:
            continue
        task_id = getattr(each.request_body, "task_id", 0)  # 0: the robot chooses one
        for t, proc in reports:
            is_of_task = proc.robot_task_id == task_id if task_id else proc.robot_task_id != 0
            if is_of_task and 0.0 <= t - each.t <= _MAX_FIRST_REPORT:
                times.append(t - each.t)
                break
    if times:
        # evenly spaced quantiles, because the simulator chooses one of the values at random
        count = min(_FIRST_REPORTS, len(times))
        shares = [(number + 0.5) / count for number in range(count)]
        values = [round(quantile(times, share), 2) for share in shares]
        yield ("tasks", "first_report"), Learned(values, len(times))


def _order_effects(seen: Observations) -> _Found:
    """Yield the distribution of the times from sending an ActionOrder to the next TaskProc."""
    reports = seen.pushed(robot.TaskProc)
    effects = []
    for order in seen.accepted(pack.ActionOrder):
        sent_at = order.t - order.delay
        effect = next((t - sent_at for t, _ in reports if t >= sent_at), math.inf)
        if effect <= _MAX_EFFECT:
            effects.append(effect)
    if len(effects) >= _MIN_SAMPLES:
        yield ("tasks", "order_effect"), _distribution(effects)


def _empty_reports(seen: Observations) -> _Found:
    """Yield the shortest and longest time from the last report of a task to the empty report.

    The empty report follows the last report of some tasks; it names no task.
    """
    empty = [
        later - t
        for (t, proc), (later, after) in pairwise(seen.pushed(robot.TaskProc))
        if proc.state in _ENDED and not after.robot_task_id and later - t <= _MAX_EMPTY
    ]
    if empty:
        yield ("tasks", "empty_report"), _interval(empty)


_SLOW = {cls.DESCRIPTOR.full_name for cls in (pack.InitRobot, pack.BuildMap)}
"""Requests that are answered only after their execution; their times have their own fields."""


def _answers(seen: Observations) -> _Found:
    """Yield the answer times of InitRobot and of each type of request, and a default for others.

    Types with times of their own in the profile `tr200` are unusual: they do not count for the
    default.
    """
    delays: dict[str, list[float]] = {}
    for each in seen.answers:
        if each.ok and each.request in message_types() and each.request not in _SLOW:
            delays.setdefault(each.request, []).append(each.delay)
    delays = {name: found for name, found in delays.items() if len(found) >= _MIN_SAMPLES}
    times = {name: _distribution(found) for name, found in sorted(delays.items())}
    own_times = reference()["answers"]["requests"]
    usual = [each for name, each in times.items() if name not in own_times]
    if usual:  # each type counts once, so that a slow or a frequent type changes little
        medians = [
            quantile(column, 0.5) for column in zip(*(each.value for each in usual), strict=True)
        ]
        samples = sum(each.samples for each in usual)
        yield ("answers", "default"), Learned(list(map(_round_to_ms, medians)), samples)
    for name, found in times.items():
        yield ("answers", "requests", name), found
    done = [each.delay for each in seen.accepted(pack.InitRobot)]
    if done:
        yield ("answers", "initialisation"), _interval(done)


_MAX_PICTURE_GAP = 10.0
"""Longer gaps between two pictures of a map in the making are pauses, in seconds."""


def _mapping(seen: Observations) -> _Found:
    """Yield the time between two pictures of a map in the making, and answer times of BuildMap."""
    pictures = [t for t, _ in seen.pushed(pack.BuildMapData)]
    periods = _gaps(pictures, ignore_above=_MAX_PICTURE_GAP)
    if len(periods) >= _MIN_SAMPLES:
        period = Learned(_round_to_ms(quantile(periods, 0.5)), len(periods))
        yield ("mapping", "picture_period"), period
    delays: dict[int, list[float]] = {}
    for each in seen.accepted(pack.BuildMap):
        delays.setdefault(getattr(each.request_body, "type", 0), []).append(each.delay)
    starts = delays.get(pack.BuildMap.kAdd, []) + delays.get(pack.BuildMap.kUpdate, [])
    if starts:
        yield ("mapping", "start"), _interval(starts)
    if saves := delays.get(pack.BuildMap.kSave):
        yield ("mapping", "save"), _distribution(saves)
    if cancels := delays.get(pack.BuildMap.kCanel):  # spelled so in the robot's messages
        yield ("mapping", "cancel"), _interval(cancels)


_MAX_GAP_MOVING = 2.0
"""Longer gaps between two pushes of PoseSpeed mean that the robot stood, in seconds."""
_MIN_PERIOD_RATIO = 0.7
"""Ratio of scan period to push period above which each scan counts as pushed."""


def _rates(seen: Observations) -> _Found:
    """Yield the times between two pushes of PoseSpeed or Battery, and between scans."""
    moving = _gaps([t for t, _ in seen.pushed(robot.PoseSpeed)], ignore_above=_MAX_GAP_MOVING)
    if len(moving) >= _MIN_SAMPLES:
        yield ("rates", "pose_speed"), _median(moving)
    yield from _scan_rates(seen)
    # a push without a change is a periodic one
    batteries = seen.pushed(robot.Battery)
    repeated = [after - t for (t, one), (after, two) in pairwise(batteries) if one == two]
    if len(repeated) >= _MIN_SAMPLES:
        yield ("rates", "battery"), _interval(repeated)


def _scan_rates(seen: Observations) -> _Found:
    """Yield the time between two pushes of a scan, and between two scans that the laser makes.

    The laser may make more scans than are pushed: requests for scans show that.
    """
    pushed = _gaps(
        [each.t for each in of_busiest_connection([each for each in seen.scans if each.pushed])]
    )
    scan = _scan_period(seen)
    if len(pushed) >= _MIN_SAMPLES:
        push = _median(pushed)
        yield ("rates", "scan_push"), push
        if scan:
            is_each_pushed = scan.value > _MIN_PERIOD_RATIO * push.value
        else:  # not measured: the reference stays, unless scans are pushed more often than that
            is_each_pushed = reference()["rates"]["scan"] > push.value
        if is_each_pushed:
            scan = push
    if scan:
        yield ("rates", "scan"), scan


def _scan_period(seen: Observations) -> Learned | None:
    """Return the time between two scans; None if the requests for scans do not show it.

    They show it if they were more frequent than the scans.
    """
    polls = of_busiest_connection([each for each in seen.scans if not each.pushed])
    # a pause of more than 1 s ends a series of polls
    ends = [number for number, gap in enumerate(_gaps([each.t for each in polls]), 1) if gap > 1.0]
    gaps: list[float] = []
    for begin, end in pairwise([0, *ends, len(polls)]):
        series = polls[begin:end]
        changes = [two.t for one, two in pairwise(series) if one.ranges != two.ranges]
        if len(series) >= 2 * len(changes):  # at least two polls per scan
            gaps += _gaps(changes)
    if len(gaps) < _MIN_SAMPLES:
        return None
    # Late answers make the shortest and longest gaps. All others are multiples of the time between
    # two polls, of which only the mean is exact.
    quarter = len(gaps) // 4
    middle = sorted(gaps)[quarter : len(gaps) - quarter]
    return Learned(_round_to_ms(sum(middle) / len(middle)), len(gaps))


def _laser(seen: Observations) -> _Found:
    """Yield the geometry of the laser, from the last scan."""
    scan, count = seen.latest(robot.ScannerData)
    if scan is None:
        return
    values: dict[str, float] = {}
    if scan.angle_increment > 0.0 and scan.angle_max > scan.angle_min:
        values["angle_min"], values["angle_max"] = scan.angle_min, scan.angle_max
        values["increment"] = scan.angle_increment
    if 0.0 <= scan.range_min < scan.range_max:
        values["range_min"], values["range_max"] = scan.range_min, scan.range_max
    if scan.scan_time > 0.0:
        values["scan_time"] = scan.scan_time
    if scan.HasField("offset"):
        values["forward"] = scan.offset.x
    for name, value in values.items():
        if math.isfinite(value):
            yield ("laser", name), Learned(round(value, 6), count)


_STANDING = 0.01
"""Speed up to which a robot stands, in m/s or rad/s."""
_MIN_MOVING = 10
"""Minimum number of reports of a moving robot to learn its maximum speeds."""
_MAX_START = 3.0
"""Maximum time from a velocity to the first motion, in seconds."""


def _speeds(seen: Observations) -> _Found:
    """Yield the maximum speeds."""
    twists = [each.twist for _, each in seen.pushed(robot.PoseSpeed)]
    for name, speeds in (
        ("max_speed", [abs(each.linear) for each in twists if abs(each.linear) > _STANDING]),
        ("max_turn_rate", [abs(each.angular) for each in twists if abs(each.angular) > _STANDING]),
    ):
        if len(speeds) >= _MIN_MOVING:
            yield ("driving", name), Learned(round(max(speeds), 3), len(speeds))


def _start_delays(seen: Observations) -> _Found:
    """Yield the median time from the first velocity to a standing robot to its first motion."""
    poses = seen.pushed(robot.PoseSpeed)
    start_delays, last_sent_at = [], -math.inf
    for velocity in seen.accepted(pack.Twist):
        if velocity.request_body == pack.Twist():  # a stop
            continue
        sent_at = velocity.t - velocity.delay
        is_after_pause = sent_at - last_sent_at > _MAX_START
        last_sent_at = sent_at
        if not is_after_pause:
            continue
        # a moving robot pushes its pose often
        was_standing = not any(0.0 <= sent_at - t <= _MAX_GAP_MOVING for t, _ in poses)
        if was_standing:
            delay = next((t - sent_at for t, _ in poses if t > sent_at), math.inf)
            if delay <= _MAX_START:
                start_delays.append(delay)
    if len(start_delays) >= _MIN_SAMPLES:
        yield ("driving", "start_delay"), _median(start_delays)


def _battery(seen: Observations) -> _Found:
    """Yield the constants in the last Battery."""
    battery, count = seen.latest(robot.Battery)
    if battery:
        # a profile takes no negative values
        for name in ("health", "charge_cycle", "battery_cycle", "temp_max"):
            yield ("battery", name), Learned(max(0, getattr(battery, name)), count)


_QUERIES = {each.request for each in QUERIES}
_DEFAULT_TEXTS = {each.words for each in REFUSALS.values()}
"""Texts of refusals that the simulator has without a profile."""


def _texts(seen: Observations) -> _Found:
    """Yield the texts of refusals, and the language of status codes."""
    accepted = {each.request for each in seen.answers if each.ok}
    texts: dict[str, Counter[str]] = {}
    for each in seen.answers:
        if not each.ok and each.request in message_types():
            texts.setdefault(each.request, Counter())[printable(each.text)] += 1
    for name, found in sorted(texts.items()):
        text, count = found.most_common(1)[0]
        # not a command, whose refusal may depend on the state of the robot
        is_always_refused = name in _QUERIES and name not in accepted
        if is_always_refused:
            yield ("refusals", "always", name), Learned(text or REQUEST_FAILED, count)
        elif text and text not in _DEFAULT_TEXTS:
            yield ("refusals", "texts", name), Learned(text, count)
    messages = [code.msg for body in seen.bodies() for code in codes_in(body) if code.code]
    if messages:
        foreign = any(not text.isascii() for text in messages)
        language = "zh" if foreign else "en" if any(messages) else "none"
        yield ("status_codes", "language"), Learned(language, len(messages))


def _gaps(timestamps: Sequence[float], ignore_above: float = math.inf) -> list[float]:
    """Return the times between two timestamps, in seconds, without those over `ignore_above`."""
    gaps = [after - before for before, after in pairwise(timestamps)]
    return [each for each in gaps if each <= ignore_above]  # longer gaps are pauses


def _round_to_ms(seconds: float) -> float:
    return round(seconds, 3)


def _median(durations: Sequence[float]) -> Learned:
    return Learned(_round_to_ms(quantile(durations, 0.5)), len(durations))


def _distribution(durations: Sequence[float]) -> Learned:
    """Return the median, the 90 % quantile and the maximum."""
    shares = (0.5, 0.9, 1.0)
    return Learned([_round_to_ms(quantile(durations, each)) for each in shares], len(durations))


def _interval(durations: Sequence[float]) -> Learned:
    """Return the minimum and the maximum."""
    return Learned([_round_to_ms(min(durations)), _round_to_ms(max(durations))], len(durations))


@lru_cache
def reference() -> dict[str, dict[str, Any]]:
    """Return the values of the profile `tr200`, by section and field."""
    file = SHIPPED_FOLDER / f"{REFERENCE}.yaml"
    values: dict[str, dict[str, Any]] = load_yaml(file.name, file.read_bytes())
    return values


_TIMES = {"answers", "mapping", "rates", "tasks"}
"""Sections with times, which depend on this computer and the network, too."""
_TIME_TOLERANCE, _TOLERANCE = (0.1, 0.02), (0.01, 0.0)
"""Relative and absolute tolerance, of times (in seconds) and of other numbers.

Numbers differ if they differ by more than both.
"""


def known_value(path: KeyPath) -> Any:
    """Return the value of `tr200` for the same keys as a learned value; None if it has none.

    Requests without answer times of their own have the default ones.
    """
    known: Any = reference()
    for key in path:
        known = known.get(key) if isinstance(known, dict) else None
    if known is None and path[:2] == ("answers", "requests"):
        return reference()["answers"]["default"]
    return known


def differs(path: KeyPath, value: Any) -> bool:
    """Return True if a learned value differs from the value of `tr200`."""
    known = known_value(path)
    if path == ("tasks", "first_report"):  # the order of these values has no meaning
        value, known = sorted(value), sorted(known)
    return _differ(value, known, *(_TIME_TOLERANCE if path[0] in _TIMES else _TOLERANCE))


def _differ(one: Any, other: Any, relative: float, absolute: float) -> bool:
    """Return True if two values, or items of lists, differ by more than both tolerances."""
    if isinstance(one, list) and isinstance(other, list):
        pairs = zip(one, other, strict=False)
        return len(one) != len(other) or any(_differ(*each, relative, absolute) for each in pairs)
    if any(isinstance(each, str | None | list) for each in (one, other)):  # not two numbers
        return bool(one != other)
    gap = abs(one - other)
    return bool(gap > absolute and gap > relative * max(abs(one), abs(other)))


_NOT_LEARNED = {
    "tasks": "starting_states between_jobs state_first report_last_action final_wait leave_dock "
    "pause_at_obstacle obstacle_timeout charge_as_parking messages own_id_factor own_id_offset",
    "mapping": "state_after scene_after",
    "laser": "noise",
    "driving": "rolls_for stops_below",
    "battery": "idle_drain driving_drain charging_rate",
    "charging": "docking_distance docking_speed starts_after confirmed_after completed_after",
    "refusals": "explained codes while_busy",
}
"""Fields of a profile that are never learned, whatever a robot shows."""


def profile_text(values: Mapping[KeyPath, Learned], source: str) -> str:
    """Return the text of a profile's file; its heading names the `source` of the values.

    Raises:
        DataFileError: the values do not make a profile.
    """
    lines = [
        f"# Learned from {printable(source)}. Values with a number of samples are of the robot,",
        f"# all others of {REFERENCE}. docs/simulator_reference.md describes the fields.",
        "# Not learned, whatever the robot does: change these yourself if you know better.",
    ]
    for section, names in _NOT_LEARNED.items():
        lines += textwrap.wrap(
            f"{section}: {', '.join(names.split())}",
            96,
            initial_indent="#   ",
            subsequent_indent="#     ",
        )
    for section, fields in reference().items():
        lines += ["", f"{section}:"]
        for name, value in fields.items():
            # learned values within this field, also with keys that the reference lacks
            learned = {
                path[2]: each
                for path, each in values.items()
                if path[:2] == (section, name) and path[2:]
            }
            has_keys = isinstance(value, dict) and (value or learned)
            if has_keys:  # otherwise one line, also for an empty mapping
                lines.append(f"  {name}:")
                merged = {**{key: Learned(each, 0) for key, each in value.items()}, **learned}
                lines += [f"    {key}: {_value(each)}" for key, each in merged.items()]
            else:
                lines.append(f"  {name}: {_value(values.get((section, name), Learned(value, 0)))}")
    text = "\n".join(lines) + "\n"
    # only checks the values; the result is not needed
    structure(Profile, load_yaml("profile", text.encode()), "profile")
    return text


def _value(learned: Learned) -> str:
    """Return a value as YAML, with its number of samples as a comment if it was learned."""
    text = json.dumps(learned.value, ensure_ascii=False)
    samples = "1 sample" if learned.samples == 1 else f"{learned.samples} samples"
    return f"{text}  # {samples}" if learned.samples else text


@dataclass(frozen=True)
class _Entry:
    """A learned value in the file of a survey; `field` has its keys in a profile."""

    field: tuple[str, ...]
    value: Any
    samples: Annotated[int, Between(1)]


@dataclass(frozen=True)
class _Survey:
    """The part of the survey file that this module reads."""

    profile: tuple[_Entry, ...]


SURVEY_FILE = "survey.json"
"""File with the results of a survey, in its folder."""
_MAX_SURVEY = 16 * 1024 * 1024
"""Maximum size of the survey file, in bytes."""


def learn_profile(source: Path, target: Path) -> str:
    """Write the profile of a robot.

    Args:
        source: a recording, or the folder of a survey.
        target: path of the profile, which must not exist.

    Returns:
        A text that says what was written.

    Raises:
        DataFileError: the source cannot be used, shows nothing, or the file cannot be written.
    """
    if source.is_dir():
        file = source / SURVEY_FILE
        try:
            data = file.read_bytes()
        except OSError as error:
            text = f"{file}: {error.strerror}: give the folder of a survey, or a recording"
            raise DataFileError(text) from None
        content = load_json(file.name, data, _MAX_SURVEY)
        entries = structure(_Survey, content, file.name, known_only=False).profile
        values = {
            each.field: Learned(each.value, each.samples)
            for each in entries
            if _is_field(each.field)
        }
    else:
        values = learn(observe_recording(source))
    if not values:
        raise DataFileError(f"{source}: it shows nothing that a profile has")
    text = profile_text(values, source.name)
    try:
        with target.open("x", encoding="utf-8") as opened:
            opened.write(text)
    except OSError as error:
        raise DataFileError(f"{target}: {error.strerror}: give --profile a new file") from None
    return f"{target}: {len(values)} values of the robot, all others are those of {REFERENCE}"


def observe_recording(path: Path) -> Observations:
    """Return the observations in a recording.

    Raises:
        DataFileError: the recording cannot be read.
    """
    # imported here, because it needs mcap, and surveys do not
    from woosh_robot_agent.tools.recording.layout import Frame
    from woosh_robot_agent.tools.recording.reader import read_recording

    try:
        recording = read_recording(path)
    except ToolError as error:
        raise DataFileError(str(error)) from None
    return Observations(
        SeenFrame(recording.started + each.t, each.connection, each.sender == "chassis", each.data)
        for each in recording.records
        if isinstance(each, Frame) and not each.invalid
    )
