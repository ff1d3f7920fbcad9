"""Handlers of requests for the running statistics."""

from __future__ import annotations

import math
from collections.abc import Iterable

from woosh_robot_agent.pb.robot import robot_count_pb2 as count_pb2
from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.body.statistics import Record
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result
from woosh_robot_agent.simulator.refusals import RefusedError

_PAGE = 100
"""Number of records of a page."""

_Count = pack.CountData


def _count_data(chassis: Chassis, request: pack.CountData) -> Result:
    chassis.statistics.update()
    if request.req_type == _Count.kGet:
        return _page(chassis, request)
    if request.req_type == _Count.kSync:
        return _with_ids(chassis, request)
    raise RefusedError(refusals.UNKNOWN_COUNT_REQUEST, type=request.req_type)


def _page(chassis: Chassis, request: pack.CountData) -> pack.CountDataResponse:
    """Return one page of the records of the wanted kinds, and the number of all of them."""
    kinds = (_Count.kOperation, _Count.kTask, _Count.kStatus)
    if request.count_type not in (_Count.kAll, *kinds):
        raise RefusedError(refusals.UNKNOWN_COUNT_TYPE, type=request.count_type)
    pages = (request.operation_page, request.task_page, request.status_page)
    if min(pages) < 0:
        raise RefusedError(refusals.NEGATIVE_PAGE, page=min(pages))
    first, last = request.bucket.start, request.bucket.end or math.inf
    if last < first:
        raise RefusedError(refusals.TIME_SPAN_REVERSED, start=first, end=last)
    statistics = chassis.statistics
    wanted = [request.count_type in (_Count.kAll, kind) for kind in kinds]
    days = _within(statistics.days, first, last) if wanted[0] else []
    tasks = _within(statistics.tasks, first, last) if wanted[1] else []
    statuses = _within(statistics.statuses, first, last) if wanted[2] else []
    return pack.CountDataResponse(
        operations=count_pb2.Operations(ops=_part(days, request.operation_page)),
        tasks=count_pb2.Tasks(ts=_part(tasks, request.task_page)),
        abnormals=count_pb2.Abnormals(ss=_part(statuses, request.status_page)),
        operation_qty=len(days),
        task_qty=len(tasks),
        abnormal_qty=len(statuses),
    )


def _with_ids(chassis: Chassis, request: pack.CountData) -> pack.CountDataResponse:
    """Return the records with the given ids. Ids without a record are left out."""
    statistics = chassis.statistics
    days = _chosen(statistics.days, request.operation_id)
    tasks = _chosen(statistics.tasks, request.task_id)
    statuses = _chosen(statistics.statuses, request.status_id)
    return pack.CountDataResponse(
        operations=count_pb2.Operations(ops=days),
        tasks=count_pb2.Tasks(ts=tasks),
        abnormals=count_pb2.Abnormals(ss=statuses),
        operation_qty=len(days),
        task_qty=len(tasks),
        abnormal_qty=len(statuses),
    )


def _within(records: Iterable[Record], first: float, last: float) -> list[Record]:
    """Return the records of a time span: those that began before its end and ended after its start.

    Args:
        records: The records.
        first: Start of the time span as Unix time, in seconds.
        last: End of the time span as Unix time, in seconds.
    """
    found = []
    for record in records:
        span = _span(record)
        if span.start <= last and (span.end or math.inf) >= first:
            found.append(record)
    return found


def _span(
    record: count_pb2.Operation | count_pb2.Task | count_pb2.Status,
) -> common_pb2.TimeBucket:
    return record.buckets[0] if isinstance(record, count_pb2.Operation) else record.bucket


def _part(records: list[Record], page: int) -> list[Record]:
    return records[page * _PAGE : (page + 1) * _PAGE]


def _chosen(records: Iterable[Record], ids: Iterable[int]) -> list[Record]:
    wanted = set(ids)
    return [record for record in records if record.id in wanted]


def _operation(chassis: Chassis, request: count_pb2.Operation) -> Result:
    chassis.statistics.update()
    return chassis.statistics.days.latest


def _task(chassis: Chassis, request: count_pb2.Task) -> Result:
    return chassis.statistics.tasks.latest or count_pb2.Task(robot_id=chassis.robot_id)


def _status(chassis: Chassis, request: count_pb2.Status) -> Result:
    return chassis.statistics.statuses.latest or count_pb2.Status(robot_id=chassis.robot_id)


HANDLERS: Handlers = {
    pack.CountData: _count_data,
    count_pb2.Operation: _operation,
    count_pb2.Task: _task,
    count_pb2.Status: _status,
}
