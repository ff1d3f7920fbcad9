"""The running statistics, and the status codes: records of days, tasks and problems."""

from __future__ import annotations

import datetime
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_count_pb2
from woosh_robot_agent.pb.robot import robot_count_pb2 as count_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.status_codes import Code, Language

_MAX_RECORDS = 10_000
"""Number of records of each kind that are kept."""

_ENDS = {
    util_task_pb2.kCompleted: count_pb2.Task.kCompleted,
    util_task_pb2.kFailed: count_pb2.Task.kFailed,
    util_task_pb2.kCanceled: count_pb2.Task.kCancel,
}
"""States in the records of ended tasks, by the state of the task."""

Record = TypeVar("Record", count_pb2.Operation, count_pb2.Task, count_pb2.Status)


class Robot(Protocol):
    """The parts of the robot that the statistics use."""

    @property
    def robot_id(self) -> int:
        """Number of the robot."""

    @property
    def time(self) -> float:
        """Simulated Unix time, in seconds."""

    @property
    def elapsed(self) -> float:
        """Simulated time since the start, in seconds."""

    def emit(self, event: Message) -> None:
        """Send a message to all its subscribers. It must not be modified afterwards."""


class Records(Generic[Record]):
    """The records of one kind, oldest first. A record that changes is replaced, not modified."""

    def __init__(self) -> None:
        self._records: dict[int, Record] = {}
        self._last_id = 0

    def __iter__(self) -> Iterator[Record]:
        return iter(list(self._records.values()))

    @property
    def latest(self) -> Record | None:
        """The record that was opened last, None if there is none."""
        return self._records.get(self._last_id)

    def new_id(self) -> int:
        """Return the id of the next record."""
        self._last_id += 1
        return self._last_id

    def put(self, record: Record) -> None:
        """Add a record, or replace the one with its id. Beyond a limit, drop the oldest one."""
        self._records[record.id] = record
        if len(self._records) > _MAX_RECORDS:
            del self._records[next(iter(self._records))]


@dataclass(frozen=True, slots=True)
class _Day:
    """An open record of a day.

    Attributes:
        id: Id of the record.
        date: Date by the clock of the robot, as a number: year, month and day, e.g. 20251231.
        time: Unix time of its start by the clock of the robot, in seconds.
        start: Simulated time of its start, in seconds.
        mileage: Mileage at its start, in metres.
    """

    id: int
    date: int
    time: float
    start: float
    mileage: int


class Statistics:
    """Counts what the robot does. A record is pushed when it opens, when it changes and at its end.

    There is a record for each day on which the robot is switched on, for each task, and for each
    problem that a status code has reported. Durations do not depend on the robot's clock, which may
    jump.

    Args:
        robot: The robot.
        odometer: Total distance driven so far, in metres.
        period: Time after which the record of the day is pushed again although the robot has not
            driven, in seconds; None for never.

    Attributes:
        days: Records of the days. That of the present day is as `update` or a push left it.
        tasks: Records of the tasks.
        statuses: Records of the problems.
    """

    def __init__(self, robot: Robot, odometer: float, period: float | None) -> None:
        self.days: Records[count_pb2.Operation] = Records()
        self.tasks: Records[count_pb2.Task] = Records()
        self.statuses: Records[count_pb2.Status] = Records()
        self._robot = robot
        self._period = math.inf if period is None else period
        self._mileage = int(odometer)
        self._day = self._new_day()
        self._next_report = robot.elapsed + self._period
        """Simulated time at which the record of the day is pushed again, in seconds."""
        self.update()
        self._task_start = 0.0
        """Simulated time at which the last task started, in seconds."""
        self._problems: dict[int, tuple[count_pb2.Status, float]] = {}
        """Records of the present problems and the simulated times of their starts, by code."""

    def tick(self, odometer: float) -> None:
        """Push the record of the day if it is due, and begin a new one with a new day.

        Args:
            odometer: Total distance driven, in metres.
        """
        driven = int(odometer) != self._mileage
        self._mileage = int(odometer)
        if _date(self._robot.time) != self._day.date:
            self._report_day(end=True)
            self._day = self._new_day()
            self._report_day()
        elif driven or self._robot.elapsed >= self._next_report:
            self._report_day()

    def update(self) -> None:
        """Bring the record of the present day up to date, without pushing it."""
        self.days.put(self._operation())

    def task_started(self, task_id: int, dest: str) -> None:
        """Open the record of a task.

        Args:
            task_id: Its `robot_task_id`.
            dest: Number of its target mark, empty if the target is not a mark.
        """
        self._task_start = self._robot.elapsed
        record = count_pb2.Task(
            robot_id=self._robot.robot_id,
            id=self.tasks.new_id(),
            task_id=task_id,
            dest=dest,
            state=count_pb2.Task.kExecuting,
            bucket=self._opened(),
        )
        self._publish(self.tasks, record)

    def task_ended(self, state: util_task_pb2.State) -> None:
        """Close the record of the last task, which is now completed, cancelled or failed."""
        latest = self.tasks.latest
        if latest is None or latest.end:
            return
        record = count_pb2.Task()
        record.CopyFrom(latest)
        record.state = _ENDS[state]
        record.bucket.end = int(self._robot.time)
        record.cons = round(self._robot.elapsed - self._task_start)
        record.end = True
        self._publish(self.tasks, record)

    def problem_occurred(self, status: count_pb2.StatusCode) -> None:
        """Add the record of a problem that does not last."""
        record = self._problem(status)
        record.bucket.end = record.bucket.start
        record.end = True
        self._publish(self.statuses, record)

    def problem_began(self, status: count_pb2.StatusCode) -> None:
        """Open the record of a problem that lasts until `problem_ended`."""
        record = self._problem(status)
        self._problems[status.code] = record, self._robot.elapsed
        self._publish(self.statuses, record)

    def problem_ended(self, code: int) -> None:
        """Close the record of the problem with this status code."""
        began, start = self._problems.pop(code)
        record = count_pb2.Status()
        record.CopyFrom(began)
        record.bucket.end = int(self._robot.time)
        record.cons = round(self._robot.elapsed - start)
        record.end = True
        self._publish(self.statuses, record)

    def _problem(self, status: count_pb2.StatusCode) -> count_pb2.Status:
        return count_pb2.Status(
            robot_id=self._robot.robot_id,
            id=self.statuses.new_id(),
            info=status,
            bucket=self._opened(),
        )

    def _new_day(self) -> _Day:
        now, id_ = self._robot.time, self.days.new_id()
        return _Day(id_, _date(now), now, self._robot.elapsed, self._mileage)

    def _report_day(self, *, end: bool = False) -> None:
        self._next_report = self._robot.elapsed + self._period
        self._publish(self.days, self._operation(end=end))

    def _operation(self, *, end: bool = False) -> count_pb2.Operation:
        """Return the record of the day as it is now."""
        day = self._day
        return count_pb2.Operation(
            robot_id=self._robot.robot_id,
            id=day.id,
            date=day.date,
            mileage=count_pb2.Operation.Mileage(start=day.mileage, end=self._mileage),
            buckets=[common_pb2.TimeBucket(start=int(day.time), end=int(self._robot.time))],
            distance=self._mileage - day.mileage,
            uptime=int(self._robot.elapsed - day.start),
            end=end,
        )

    def _opened(self) -> common_pb2.TimeBucket:
        return common_pb2.TimeBucket(start=int(self._robot.time))

    def _publish(self, records: Records[Record], record: Record) -> None:
        records.put(record)
        self._robot.emit(record)


def _date(time: float) -> int:
    """Return the UTC date of a Unix time as a number: year, month and day."""
    day = datetime.datetime.fromtimestamp(time, datetime.timezone.utc)
    return day.year * 10_000 + day.month * 100 + day.day


_MAX_RECENT = 50
"""Number of status codes that are kept."""


Publish = Callable[[robot_count_pb2.StatusCode], None]


class Codes:
    """The log of status codes.

    Args:
        language: Language of the texts.
        publish: Adds time, state and task to a new code, and sends it to the clients.
        statistics: Counts the problems: codes from warnings upwards, and those of `watch`.

    Attributes:
        recent: The last 50 codes, oldest first.
    """

    def __init__(self, language: Language, publish: Publish, statistics: Statistics) -> None:
        self.recent: deque[robot_count_pb2.StatusCode] = deque(maxlen=_MAX_RECENT)
        self._language = language
        self._publish = publish
        self._statistics = statistics
        self._abnormal: dict[int, robot_count_pb2.StatusCode] = {}

    @property
    def abnormal(self) -> list[robot_count_pb2.StatusCode]:
        """Codes of the current problems, in the order in which they began."""
        return list(self._abnormal.values())

    def report(
        self,
        code: Code,
        kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined,
        detail: str = "",
    ) -> None:
        """Log a status code and send it to the clients.

        Args:
            code: The code.
            kind: Kind of the action that the code is about.
            detail: Further text, in English; it is left out in other languages.
        """
        status = self._report(code, kind, detail)
        if code.level >= robot_count_pb2.StatusCode.kWarn:
            self._statistics.problem_occurred(status)

    def watch(self, code: Code, *, present: bool) -> None:
        """Report a code when its cause appears, and list it as abnormal until the cause is gone."""
        if present and code.number not in self._abnormal:
            status = self._abnormal[code.number] = self._report(code)
            self._statistics.problem_began(status)
        elif not present and code.number in self._abnormal:
            del self._abnormal[code.number]
            self._statistics.problem_ended(code.number)

    def _report(
        self,
        code: Code,
        kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined,
        detail: str = "",
    ) -> robot_count_pb2.StatusCode:
        text = code.text(self._language)
        if detail and self._language == "en":
            text += f": {detail}"
        status = robot_count_pb2.StatusCode(code=code.number, msg=text, level=code.level, type=kind)
        self._publish(status)
        self.recent.append(status)
        return status
