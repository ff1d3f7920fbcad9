"""Compare the simulated chassis with the logs of a real robot: states, their order, times, rates.

scripts/bench --real                 print the tables

The logs are in tests/facts/real_tasks.json, their figures in tests/facts/real_robot.yaml. All times
are simulated time, so the load of the machine does not matter.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from benchmarks.figures import Figure, markdown
from tests.fact_files import FOLDER
from tests.simulator.real_tasks import (
    CANCEL,
    CONTINUE,
    EXEC_PRE_TASK,
    ORDER,
    PAUSE,
    SCENARIOS,
    STATE,
    TASK_PROC,
    Triple,
    ended,
    exec_task,
    matches,
    real_robot,
    shows,
    task_id,
    triple,
)
from tests.simulator.recorded_chassis import Frame, SteppedChassis, answer_times, ask, wait_frame
from woosh_robot_agent.pb.util import robot_pb2

_SEEDS = range(8)
"""Seeds of the simulated runs."""
_ANSWERS = 300
"""Number of requests of each type whose answers are timed."""
TOLERANCE = 0.2
"""Share by which a simulated time may differ from the real one."""
RESOLUTION = 0.016
"""Resolution of the times in the logs of the real robot, in seconds."""
_NEXT_TASK = "kIdle to first report of the next task"
_FACTS = {_NEXT_TASK: "answer to first report"}
"""Names of times in the figures of the real robot, where they differ from the names here."""
_EFFECTS = {"kSuspend": "pause", "kRosCancel": "cancel", "kRosExecuting": "continue"}
"""Orders by the action state in the report that shows their effect."""
BUILD_MAP = "woosh.robot.BuildMap"
_UNINIT, _IDLE, _MAPPING = robot_pb2.kUninit, robot_pb2.kIdle, robot_pb2.kMapping

Times = dict[str, list[float]]
"""Times in seconds, by name."""
Runs = dict[str, list[list[Triple]]]
"""Reports of each run of each scenario."""


class Event(NamedTuple):
    """An observed event of a task.

    Attributes:
        time: time, in seconds.
        kind: `answer`, `order`, `state` or `report`.
        body: body of the message.
    """

    time: float
    kind: str
    body: Any


def events_of_log(task: Any) -> list[Event]:
    """Return the events of a task in the logs of the real robot."""
    sources = {"answer": "answer", "order by another client": "order"}
    pushes = {TASK_PROC: "report", STATE: "state"}
    found = []
    for time, source, type_name, body in task["frames"]:
        kind = sources.get(source) or pushes.get(type_name)
        if kind:
            found.append(Event(time, kind, body))
    return found


def events_of_run(frames: Iterable[Frame]) -> list[Event]:
    """Return the events of the task in the frames of a simulated run."""
    found = []
    for frame in frames:
        if frame.sn:
            kind = "order" if frame.type == ORDER else "answer"
            found.append(Event(frame.time, kind, frame.body))
        elif frame.type in (TASK_PROC, STATE):
            kind = "report" if frame.type == TASK_PROC else "state"
            found.append(Event(frame.time, kind, frame.body))
    return found


def times_of_task(events: Sequence[Event]) -> Times:
    """Return the times between the events of a task."""
    found: Times = {}

    def add(name: str, before: Event | None, after: Event) -> None:
        if before:
            found.setdefault(name, []).append(after.time - before.time)

    answer = next((event for event in events if event.kind == "answer"), None)
    order = before = idle = None
    for event in events:
        if event.kind == "order":
            order = event
        elif event.kind == "state":
            idle = event if event.body["state"] == _IDLE else idle
        elif event.kind == "report":
            _, kind, state = triple(event.body)
            if task_id(event.body) and before is None:
                add("answer to first report", answer if order is None else None, event)
            if order and state in _EFFECTS:
                add(f"order to its effect, {_EFFECTS[state]}", order, event)
                order = None
            if before:
                _, last_kind, last_state = triple(before.body)
                if (last_kind, last_state, kind) == ("kNav", "kRosSuccess", "kWait"):
                    add("navigation to wait", before, event)
                if ended(event.body) and kind != "kCharge" and last_state == state:
                    add("last action to end of task", before, event)
                if ended(before.body) and not task_id(event.body):
                    add("end of task to empty report", before, event)
                if task_id(before.body) == 0 and task_id(event.body):
                    add(_NEXT_TASK, idle, event)
            before = event
    return found


def merged(times: Iterable[Times]) -> Times:
    """Return the times of all runs, merged by name."""
    found: Times = {}
    for each in times:
        for name, values in each.items():
            found.setdefault(name, []).extend(values)
    return found


def real_times() -> Times:
    """Return the times of the accepted tasks in the logs."""
    tasks = json.loads((FOLDER / "real_tasks.json").read_text())
    accepted = [task for task in tasks if task["end"]]
    return merged(times_of_task(events_of_log(task)) for task in accepted)


def simulated_tasks(seeds: range) -> tuple[Runs, Times]:
    """Return the reports of each scenario in each run, and the times of all of them."""
    reports: Runs = {}
    times: list[Times] = []
    for name, perform in SCENARIOS.items():
        for seed in seeds:
            chassis = SteppedChassis(seed=seed)
            reports.setdefault(name, []).append(perform(chassis).triples)
            times.append(times_of_task(events_of_run(chassis.frames)))
    for seed in seeds:
        chassis = SteppedChassis(seed=seed)
        ask(chassis, EXEC_PRE_TASK, taskSetId=666)
        wait_frame(chassis, lambda frame: task_id(frame.body) == 66602 and ended(frame.body))
        chassis.run(1.0)
        times.append(times_of_task(events_of_run(chassis.frames)))
    for orders in ((PAUSE, CONTINUE), (PAUSE, CONTINUE, CANCEL)):
        chassis = SteppedChassis(seed=len(orders))
        exec_task(chassis)
        for order in orders:
            chassis.run(5.0)
            chassis.request(ORDER, order=order)
        chassis.run(3.0)
        times.append(times_of_task(events_of_run(chassis.frames)))
    return reports, merged(times)


def sequence_figures(facts: Any, reports: Runs) -> list[Figure]:
    """Return a figure for each sequence of reports of the real robot."""
    found = []
    for name, sequence in facts["sequences"].items():
        same = [matches(run, sequence["reports"]) for run in reports[name]]
        text = " ".join(_short(each) for each in sequence["reports"])
        value = "the same" if all(same) else f"differs in {same.count(False)} of {len(same)}"
        found.append(
            Figure("reports", name, value, f"{text} ({sequence['seen']} times)", all(same))
        )
    return found


def _short(report: Any) -> str:
    return "..." if report == "..." else "/".join(name.removeprefix("k") for name in report)


def time_figures(facts: Any, simulated: Times) -> list[Figure]:
    """Return a figure for each time between reports."""
    logged = real_times()
    found = []
    for name in sorted(logged.keys() | simulated.keys()):
        expected = facts["times"].get(_FACTS.get(name, name.partition(",")[0]))
        real, ours = logged.get(name, []), simulated.get(name, [])
        found.append(_figure("task", name, expected, ours, RESOLUTION, f"; logs: {_spread(real)}"))
    return found


def _figure(
    part: str,
    name: str,
    real: Any,
    simulated: Sequence[float],
    resolution: float = 0.0,
    remark: str = "",
) -> Figure:
    """Return a figure that passes if the median of `simulated` is within the real range.

    Args:
        part: part of the comparison.
        name: name of the figure.
        real: value of the real robot, or a list of the smallest and the largest one.
        simulated: values of the simulated chassis.
        resolution: difference that the figures of the real robot do not show, beside `TOLERANCE`.
        remark: text after the value of the real robot.
    """
    least, most = real if isinstance(real, list) else (real, real)
    median = statistics.median(simulated)
    ok = (1 - TOLERANCE) * least - resolution <= median <= (1 + TOLERANCE) * most + resolution
    text = f"{least:g}" if least == most else f"{least:g} to {most:g}"
    return Figure(part, name, _spread(simulated), text + remark, ok)


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "none"
    middle, least, most = statistics.median(values), min(values), max(values)
    if most - least < 0.0005:
        return f"{middle:.3f}"
    return f"{middle:.3f} ({least:.3f} to {most:.3f})"


def answer_figures(facts: Any, count: int) -> list[Figure]:
    """Return a figure for each type of request: the delays of `count` answers."""
    found = []
    for name, (median, usual, longest) in facts["answers"].items():
        times = answer_times(name, count)
        ours = statistics.median(times), times[int(0.9 * len(times))], times[-1]
        ok = abs(ours[0] - median) <= TOLERANCE * median + RESOLUTION and ours[2] <= longest
        expected = " / ".join(f"{1000 * time:.0f}" for time in (median, usual, longest))
        value = " / ".join(f"{1000 * time:.0f}" for time in ours)
        found.append(Figure("answer, ms", name.rpartition(".")[2], value, expected, ok))
    for name, median in facts["median_answers"].items():
        middle = statistics.median(answer_times(name, 5))
        ok = abs(middle - median) <= TOLERANCE * median
        short = name.rpartition(".")[2]
        found.append(
            Figure("answer, ms", short, f"{1000 * middle:.0f}", f"{1000 * median:.0f}", ok)
        )
    return found


def drive_figures(facts: Any, seeds: range) -> list[Figure]:
    """Return the figures of a drive by velocities at 0.1 m/s, and of the reports meanwhile."""
    poses, starts, rolls, last_changes, scans = [], [], [], [], []
    for seed in seeds:
        chassis = SteppedChassis(seed=seed)
        model = chassis.chassis
        # the reports of each run have another phase relative to the commands
        model.run_until(0.006 * seed)
        begin, seen = model.elapsed, ""
        for _ in range(100):
            chassis.request("woosh.robot.Twist", linear=0.1)
            chassis.run(0.05)
            scan = ask(chassis, "woosh.robot.ScannerData").body["ranges"]
            if str(scan) != seen:
                scans.append((seed, model.elapsed))
                seen = str(scan)
        model.run_until(model.elapsed + 0.006 * seed)
        stop, place = model.elapsed, model.pose
        chassis.request("woosh.robot.Twist")
        chassis.run(3.0)
        pushed = [frame.time for frame in chassis.frames if frame.type == "woosh.robot.PoseSpeed"]
        starts.append(pushed[0] - begin)
        poses += [after - before for before, after in pairwise(pushed)]
        rolls.append(place.distance(model.pose.point))
        last_changes.append(pushed[-1] - stop)
    periods = [after[1] - before[1] for before, after in pairwise(scans) if before[0] == after[0]]
    rates, driving = facts["rates"], facts["driving"]
    rows: list[tuple[str, Any, list[float]]] = [
        ("PoseSpeed while moving, s", rates["PoseSpeed while moving"], poses),
        ("scan, s", rates["scan"], periods),
        ("Battery, s", rates["Battery"], battery_periods()),
        ("velocity to first motion, s", driving["velocity to first motion"], starts),
        ("roll after a velocity of zero, m", driving["roll after a velocity of zero"], rolls),
        (
            "velocity of zero to last change of the pose, s",
            driving["velocity of zero to last change of the pose"],
            last_changes,
        ),
    ]
    return [_figure("rate", *row) for row in rows]


def mapping_figures(facts: Any, seeds: range) -> list[Figure]:
    """Return the figures of making a map."""
    times = facts["times"]
    found: dict[str, list[float]] = {}
    for seed in seeds:
        chassis = SteppedChassis(seed=seed)
        ask(chassis, "woosh.robot.SwitchWorkMode", mode=1)
        begun = chassis.chassis.elapsed
        answer = ask(chassis, BUILD_MAP, type=1, sceneName="new", mapName="hall")
        chassis.run(5.0)
        begin_saving = chassis.chassis.elapsed
        saved = ask(chassis, BUILD_MAP, type=4)
        chassis.run(1.0)
        pushed = {
            name: [frame.time for frame in chassis.frames if wanted(frame)]
            for name, wanted in {
                "kMapping": shows(_MAPPING),
                "kUninit": shows(_UNINIT),
                "Scene": lambda frame: frame.type == "woosh.robot.Scene",
                "BuildMapData": lambda frame: frame.type == "woosh.robot.BuildMapData",
            }.items()
        }
        pictures = pushed["BuildMapData"]
        for name, values in {
            "BuildMap that starts to its answer": [answer.time - begun],
            "BuildMap that starts to kMapping": [pushed["kMapping"][0] - begun],
            "BuildMapData": [after - before for before, after in pairwise(pictures)],
            "BuildMap that saves to Scene": [pushed["Scene"][0] - begin_saving],
            "BuildMap that saves to its answer": [saved.time - begin_saving],
            "BuildMap that saves to kUninit": [pushed["kUninit"][0] - begin_saving],
        }.items():
            found.setdefault(name, []).extend(values)
    return [
        _figure("mapping", name, times.get(name) or facts["rates"][name], values)
        for name, values in found.items()
    ]


def battery_periods() -> list[float]:
    """Return the times between reports of an unchanged battery."""
    chassis = SteppedChassis()
    for _ in range(160):
        chassis.chassis.battery.level = 50.0
        chassis.run(10.0)
    times = [frame.time for frame in chassis.frames if frame.type == "woosh.robot.Battery"]
    return [after - before for before, after in pairwise(times)][1:]


def tables(groups: Sequence[tuple[str, Sequence[Figure]]]) -> str:
    """Return a Markdown table for each group of figures."""
    return "\n\n".join(
        markdown(
            (title, "Real robot", "Simulated"),
            (
                (each.name, each.limit, each.value if each.ok else f"{each.value}, **differs**")
                for each in figures
            ),
        )
        for title, figures in groups
    )


def main(arguments: Sequence[str]) -> int:
    """Compare, and print the tables.

    Returns:
        The exit status: 1 if the simulated chassis differs from the real robot.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench --real",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--smoke", action="store_true", help="simulate fewer runs, only to see that it works"
    )
    smoke = parser.parse_args(arguments).smoke
    seeds, answers = (_SEEDS[:2], _ANSWERS // 3) if smoke else (_SEEDS, _ANSWERS)
    facts = real_robot()
    reports, times = simulated_tasks(seeds)
    groups = [
        ("Reports of a task", sequence_figures(facts, reports)),
        ("Times of a task, s", time_figures(facts, times)),
        ("Answers, ms: median / 90 % / longest", answer_figures(facts, answers)),
        ("Rates and driving", drive_figures(facts, seeds)),
        ("Making a map, s", mapping_figures(facts, seeds)),
    ]
    print(tables(groups))
    return 0 if all(figure.ok for _, figures in groups for figure in figures) else 1
