"""Records of days, tasks and problems for CountData, and the log of status codes."""

from __future__ import annotations

import datetime
import math
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_count_pb2 as count_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.status_codes import Code, Language
from woosh_robot_agent.simulator.timeline import Timeline, copy_of

_MAX_RECORDS = 10_000
"""Number of records of each kind that are kept."""

_ENDS = {
    util_task_pb2.kCompleted: count_pb2.Task.kCompleted,
    util_task_pb2.kFailed: count_pb2.Task.kFailed,
    util_task_pb2.kCanceled: count_pb2.Task.kCancel,
}
"""State in the record of an ended task, by the state of the task."""

Record = TypeVar("Record", count_pb2.Task, count_pb2.Status)


class Statistics:
    """Records of what the robot does.

    There is a record for each day on which the robot is switched on, for each task, and for each
    problem that a status code has reported. A record is pushed when it is opened, changed and
    closed, except that the record of the first day is not pushed when it is opened. Durations do
    not depend on the robot's clock, which may jump.

    Args:
        timeline: the clock of the robot.
        odometer: total distance driven so far, in metres.
        period: simulated time after which the record of the day is pushed again although the robot
            has not driven, in seconds; None for never.

    Attributes:
        days: records of the days, oldest first; the last one as of the last `update`.
        tasks: records of the tasks, oldest first.
        statuses: records of the problems, oldest first.
    """

    def __init__(self, timeline: Timeline, odometer: float, period: float | None) -> None:
        self.days: deque[count_pb2.Operation] = deque(maxlen=_MAX_RECORDS)
        self.tasks: deque[count_pb2.Task] = deque(maxlen=_MAX_RECORDS)
        self.statuses: deque[count_pb2.Status] = deque(maxlen=_MAX_RECORDS)
        self._timeline = timeline
        self._period = math.inf if period is None else period
        self._mileage = int(odometer)
        """Total distance driven, in whole metres."""
        self._day_start = self._next_report = 0.0
        """Simulated times at which the record of the day began and is next pushed, in seconds."""
        self._begin_day()
        self._starts: dict[int, float] = {}
        """Simulated time at which each problem began last, in seconds, by status code."""
        self._task_start = 0.0
        """Simulated time at which the last task started, in seconds; 0 before the first."""

    def tick(self, odometer: float) -> None:
        """Push the record of the day if it is due, and open a new record at midnight (UTC).

        It is due after each metre driven, after `period`, and at the end of the day.
        """
        driven = int(odometer) != self._mileage
        self._mileage = int(odometer)
        new_day = _date(self._timeline.time) != self.days[-1].date
        if new_day or driven or self._timeline.elapsed >= self._next_report:
            self.update(end=new_day)
            self._push(self.days[-1])
            self._next_report = self._timeline.elapsed + self._period
        if new_day:
            self._begin_day()
            self._push(self.days[-1])

    def update(self, *, end: bool = False) -> None:
        """Bring the record of the present day up to date, without pushing it.

        Args:
            end: True if the day is over.
        """
        day = self.days[-1]
        day.mileage.end = self._mileage
        day.distance = self._mileage - day.mileage.start
        day.buckets[0].end = int(self._timeline.time)
        day.uptime = int(self._timeline.elapsed - self._day_start)
        day.end = end

    def task_started(self, task_id: int, dest: str) -> None:
        """Open the record of a task.

        Args:
            dest: number of the target mark, empty if the target is not a mark.
        """
        self._task_start = self._timeline.elapsed
        record = count_pb2.Task(task_id=task_id, dest=dest, state=count_pb2.Task.kExecuting)
        self._open(self.tasks, record)

    def task_ended(self, state: util_task_pb2.State) -> None:
        """Close the record of the last task, if it is open.

        Args:
            state: `kCompleted`, `kCanceled` or `kFailed`.
        """
        if self.tasks and not self.tasks[-1].end:
            self.tasks[-1].state = _ENDS[state]
            self._close(self.tasks[-1], self._task_start)

    def problem_occurred(self, status: count_pb2.StatusCode) -> None:
        """Add the record of a problem that does not last."""
        start = int(self._timeline.time)
        bucket = common_pb2.TimeBucket(start=start, end=start)
        self._open(self.statuses, count_pb2.Status(info=status, bucket=bucket, end=True))

    def problem_began(self, status: count_pb2.StatusCode) -> None:
        """Open the record of a problem that lasts until `problem_ended`."""
        self._starts[status.code] = self._timeline.elapsed
        self._open(self.statuses, count_pb2.Status(info=status))

    def problem_ended(self, code: int) -> None:
        """Close the record of the problem with this status code."""
        for record in self.statuses:
            if record.info.code == code and not record.end:
                self._close(record, self._starts[code])

    def _begin_day(self) -> None:
        """Open the record of the present day, without pushing it."""
        now, mileage = self._timeline.time, self._mileage
        self._day_start = self._timeline.elapsed
        self._next_report = self._timeline.elapsed + self._period
        self.days.append(
            count_pb2.Operation(
                robot_id=self._timeline.robot_id,
                id=_next_id(self.days),
                date=_date(now),
                mileage=count_pb2.Operation.Mileage(start=mileage, end=mileage),
                buckets=[common_pb2.TimeBucket(start=int(now), end=int(now))],
            )
        )

    def _open(self, records: deque[Record], record: Record) -> None:
        """Add a new record, and push it. It starts now, unless it has a start."""
        record.robot_id, record.id = self._timeline.robot_id, _next_id(records)
        if not record.bucket.start:
            record.bucket.start = int(self._timeline.time)
        records.append(record)
        self._push(record)

    def _close(self, record: count_pb2.Task | count_pb2.Status, start: float) -> None:
        """Close a record, and push it. `start` is the simulated time of its start, in seconds."""
        record.bucket.end = int(self._timeline.time)
        record.cons = round(self._timeline.elapsed - start)  # the duration, in seconds
        record.end = True
        self._push(record)

    def _push(self, record: Message) -> None:
        self._timeline.emit(copy_of(record))  # the record may change further


def _next_id(records: deque[Any]) -> int:
    return int(records[-1].id) + 1 if records else 1


def _date(time: float) -> int:
    """Return the UTC date of a Unix time as a number: year, month and day, e.g. 20251231."""
    day = datetime.datetime.fromtimestamp(time, datetime.timezone.utc)
    return day.year * 10_000 + day.month * 100 + day.day


_MAX_RECENT = 50
"""Number of status codes that are kept."""


class Codes:
    """The log of status codes.

    Args:
        publish: called with each new code; adds time, state and task to it, and sends it to the
            clients.
        statistics: records the problems: warnings, faults, and all codes passed to `watch`.

    Attributes:
        recent: the last 50 codes, oldest first.
    """

    def __init__(
        self,
        language: Language,
        publish: Callable[[count_pb2.StatusCode], None],
        statistics: Statistics,
    ) -> None:
        self.recent: deque[count_pb2.StatusCode] = deque(maxlen=_MAX_RECENT)
        self._language = language
        self._publish = publish
        self._statistics = statistics
        self._abnormal: dict[int, count_pb2.StatusCode] = {}
        """Codes of the current problems, by number."""

    @property
    def abnormal(self) -> list[count_pb2.StatusCode]:
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
            kind: type of the action that the code concerns; `kTypeUndefined` for none.
            detail: further text in English, which is left out in other languages; may be empty.
        """
        status = self._publish_new(code, kind, detail)
        if code.level >= count_pb2.StatusCode.kWarn:
            self._statistics.problem_occurred(status)

    def watch(self, code: Code, *, present: bool) -> None:
        """Report a code when its cause appears, and list it as abnormal until the cause is gone.

        Args:
            present: True if the cause is present at this moment.
        """
        if present and code.number not in self._abnormal:
            status = self._publish_new(code, util_action_pb2.kTypeUndefined, "")
            self._abnormal[code.number] = status
            self._statistics.problem_began(status)
        elif not present and code.number in self._abnormal:
            del self._abnormal[code.number]
            self._statistics.problem_ended(code.number)

    def _publish_new(
        self, code: Code, kind: util_action_pb2.Type, detail: str
    ) -> count_pb2.StatusCode:
        """Log a status code, send it to the clients and return it.

        `detail` is further text in English, which is left out in other languages.
        """
        text = code.text(self._language)
        if detail and self._language == "en":
            text += f": {detail}"
        status = count_pb2.StatusCode(code=code.number, msg=text, level=code.level, type=kind)
        self._publish(status)
        self.recent.append(status)
        return status
