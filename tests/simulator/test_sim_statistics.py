"""The running statistics: what they count, how they are requested, and when they are pushed."""

from __future__ import annotations

from typing import Any

import pytest

from tests.simulator.sim_wire import Json, JsonClient, pass_time
from woosh_robot_agent.pb.robot import robot_count_pb2 as count_pb2
from woosh_robot_agent.pb.robot.robot_pack_pb2 import CountData, CountDataResponse
from woosh_robot_agent.pb.util.common_pb2 import TimeBucket
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.protocol.handlers import dispatch

COUNT = "woosh.robot.CountData"
OPERATION, TASK, STATUS = (f"woosh.robot.count.{name}" for name in ("Operation", "Task", "Status"))
START = 1735689600
"""Start of the clock of a seeded run, as Unix time in seconds: 2025-01-01 00:00 UTC."""
DAY = 86400
EXECUTING, COMPLETED, FAILED, CANCELLED = 0, 1, 2, 3
EMERGENCY_STOP = "110201000013"
TO_A2 = {"taskId": 5, "type": 1, "markNo": "A2"}
UNREACHABLE = {"taskId": 5, "type": 1, "pose": {"x": -4.8, "y": -6}}


@pytest.fixture
def counted(client: JsonClient) -> JsonClient:
    client.subscribe(OPERATION, TASK, STATUS)
    return client


def test_day_begins_empty_and_is_pushed_after_each_metre_and_each_minute(
    counted: JsonClient,
) -> None:
    data = counted.ask(COUNT)
    assert (data["operationQty"], data["taskQty"], data["abnormalQty"]) == (1, 0, 0)
    (day,) = data["operations"]["ops"]
    assert (day["id"], day["date"], day["distance"], day["end"]) == (1, 20250101, 0, False)
    assert day["mileage"] == {"start": 1204, "end": 1204}
    assert (data["tasks"], data["abnormals"]) == ({"ts": []}, {"ss": []})
    for name in (TASK, STATUS):
        assert (counted.ask(name)["id"], counted.ask(name)["end"]) == (0, False)

    counted.ask("woosh.robot.ExecTask", TO_A2)
    pushed = [counted.next_push(OPERATION) for _ in range(5)]
    assert [each["distance"] for each in pushed] == [1, 2, 3, 4, 5]
    counted.next_push(TASK, lambda body: body["end"])
    (day,) = counted.ask(COUNT, {"countType": 1})["operations"]["ops"]
    driven = int(counted.simulator.state.odometer) - 1204
    assert (day["distance"], day["mileage"]) == (driven, {"start": 1204, "end": 1204 + driven})
    assert day["uptime"] <= counted.simulator.state.elapsed < day["uptime"] + 60
    assert day["buckets"] == [{"start": START, "end": START + day["uptime"]}]
    counted.take_pushes(OPERATION)
    first, second = counted.next_push(OPERATION), counted.next_push(OPERATION)
    assert first["distance"] == second["distance"] == driven
    assert second["uptime"] - first["uptime"] == 60
    assert counted.ask("woosh.robot.RobotInfo")["countOperation"]["id"] == second["id"]


@pytest.mark.parametrize(
    ("order", "body", "state"),
    [
        (None, TO_A2, COMPLETED),
        (4, TO_A2, CANCELLED),
        (None, UNREACHABLE, FAILED),
    ],
)
def test_task_is_counted_by_its_result(
    counted: JsonClient, order: int | None, body: Json, state: int
) -> None:
    counted.ask("woosh.robot.ExecTask", body)
    opened = counted.next_push(TASK)
    expected = {"id": 1, "taskId": "5", "state": EXECUTING, "cons": 0, "end": False}
    assert opened == {**opened, **expected, "dest": body.get("markNo", "")}
    assert opened["bucket"]["start"] >= START
    assert opened["bucket"]["end"] == 0
    if order:
        counted.ask("woosh.robot.ActionOrder", {"order": order})
    closed = counted.next_push(TASK)
    assert closed == {**opened, **{key: closed[key] for key in ("bucket", "cons")}} | {
        "state": state,
        "end": True,
    }
    duration = closed["bucket"]["end"] - closed["bucket"]["start"]
    assert abs(closed["cons"] - duration) <= 1
    if state == COMPLETED:
        assert closed["cons"] > 5
    if state == FAILED:  # the failure is counted, although it does not last
        failure = counted.ask(STATUS)
        assert (failure["info"]["code"], failure["info"]["robotTaskId"]) == ("140304000012", "5")
        assert (failure["end"], failure["cons"]) == (True, 0)
    assert counted.ask("woosh.robot.RobotInfo")["countTask"] == closed
    assert counted.ask(TASK) == closed


def test_each_task_of_a_set_and_each_retry_is_counted(counted: JsonClient) -> None:
    counted.ask("woosh.robot.ExecPreTask", {"taskSetId": 666})
    ids = [counted.next_push(TASK, lambda body: body["end"])["taskId"] for _ in range(2)]
    assert ids == ["66601", "66602"]
    counted.ask("woosh.robot.ExecTask", UNREACHABLE)
    counted.next_push(TASK, lambda body: body["end"])
    counted.ask("woosh.robot.ActionOrder", {"order": 5})
    retried = counted.next_push(TASK)
    assert (retried["id"], retried["taskId"], retried["state"]) == (4, "5", EXECUTING)
    assert counted.next_push(TASK)["state"] == FAILED


def test_problem_is_counted_from_its_beginning_to_its_end(counted: JsonClient) -> None:
    counted.simulator.set_emergency_stop(True)
    opened = counted.next_push(STATUS)
    assert (opened["info"]["code"], opened["bucket"]["end"]) == (EMERGENCY_STOP, 0)
    assert (opened["end"], opened["cons"]) == (False, 0)
    pass_time(counted.simulator, 30.0)
    counted.simulator.set_emergency_stop(False)
    closed = counted.next_push(STATUS)
    assert (closed["id"], closed["end"]) == (opened["id"], True)
    assert closed["cons"] >= 30
    assert abs(closed["bucket"]["end"] - closed["bucket"]["start"] - closed["cons"]) <= 1
    info = counted.ask("woosh.robot.RobotInfo")
    assert info["countError"] == closed
    assert info["abnormalCodes"]["scs"] == []


# Without sockets, in simulated time


def run(chassis: Chassis, seconds: float) -> list[Any]:
    """Let time pass, and return the statistics that were pushed meanwhile."""
    for _ in range(round(seconds / TIME_STEP)):
        chassis.tick(TIME_STEP)
    kinds = (count_pb2.Operation, count_pb2.Task, count_pb2.Status)
    return [event for event in chassis.take_events() if isinstance(event, kinds)]


def counted_data(chassis: Chassis, **request: Any) -> CountDataResponse:
    answer = dispatch(chassis, CountData(**request))
    assert answer.ok, answer.msg
    assert isinstance(answer.body, CountDataResponse)
    return answer.body


def count_tasks(chassis: Chassis, number: int) -> None:
    for each in range(number):
        chassis.statistics.task_started(each, "A2")
        chassis.statistics.task_ended(7)


def test_new_day_begins_a_new_record(chassis: Chassis) -> None:
    chassis.clock_offset = DAY - 5.0
    run(chassis, TIME_STEP)
    chassis.clock_offset = 2 * DAY - 7.0
    run(chassis, 5.0)
    (closed, opened) = run(chassis, 5.0)
    assert (closed.date, closed.end, opened.date, opened.end) == (20250102, True, 20250103, False)
    assert opened.id == closed.id + 1
    ops = counted_data(chassis).operations.ops
    assert [(each.date, each.end) for each in ops] == [
        (20250101, True),
        (20250102, True),
        (20250103, False),
    ]


def test_durations_do_not_follow_the_clock_when_it_jumps(chassis: Chassis) -> None:
    chassis.statistics.task_started(5, "A2")
    chassis.set_emergency_stop(True)
    run(chassis, 10.0)
    chassis.clock_offset = -3600.0
    chassis.statistics.task_ended(7)
    chassis.set_emergency_stop(False)
    counted = counted_data(chassis)
    assert (counted.tasks.ts[0].cons, counted.abnormals.ss[0].cons) == (10, 10)


def test_records_come_in_pages_of_100_or_by_their_ids(chassis: Chassis) -> None:
    count_tasks(chassis, 250)
    pages = [counted_data(chassis, count_type=CountData.kTask, task_page=n) for n in range(4)]
    ids = [[each.id for each in page.tasks.ts] for page in pages]
    assert ids == [[*range(1, 101)], [*range(101, 201)], [*range(201, 251)], []]
    assert {page.task_qty for page in pages} == {250}
    assert [len(page.operations.ops) for page in pages] == [0] * 4
    sync = counted_data(
        chassis, req_type=CountData.kSync, operation_id=[1], task_id=[4, 2, 999], status_id=[1]
    )
    assert [each.id for each in sync.operations.ops] == [1]
    assert [each.id for each in sync.tasks.ts] == [2, 4]
    assert (sync.operation_qty, sync.task_qty, sync.abnormal_qty) == (1, 2, 0)
    # The oldest records are dropped beyond the limit.
    count_tasks(chassis, 9_755)
    counted = counted_data(chassis)
    assert (counted.task_qty, counted.tasks.ts[0].id) == (10_000, 6)


def test_records_of_a_time_span_are_those_that_overlap_it(chassis: Chassis) -> None:
    for task in range(3):
        chassis.statistics.task_started(task, "")
        run(chassis, 10.0)
        chassis.statistics.task_ended(7)
        run(chassis, 10.0)

    def tasks_within(start: float, end: float) -> list[int]:
        bucket = TimeBucket(start=int(START + start), end=int(START + end) if end else 0)
        return [each.task_id for each in counted_data(chassis, bucket=bucket).tasks.ts]

    assert tasks_within(0, 5) == [0]
    assert tasks_within(5, 25) == [0, 1]
    assert tasks_within(12, 18) == []
    assert tasks_within(25, 0) == [1, 2]
    assert tasks_within(100, 0) == []
