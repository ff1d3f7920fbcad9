"""Actions that control the vehicle itself: pause, cancellation, requests, and log reports."""

from __future__ import annotations

import asyncio
import json
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from google.protobuf.json_format import MessageToDict
from google.protobuf.message import Message

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCodes
from woosh_robot_agent.pb.robot.robot_pb2 import TaskHistory
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.actions.performing import (
    INSTANT,
    NOT_ON_EDGES,
    Run,
    vehicle_action,
)
from woosh_robot_agent.vda5050.messages.factsheet import NOT_EMPTY, ParameterType
from woosh_robot_agent.vda5050.messages.state import NO_STATE, ActionFailedError, ErrorType
from woosh_robot_agent.vda5050.orders.instant import CANCEL_ORDER, START_PAUSE, STOP_PAUSE
from woosh_robot_agent.vda5050.orders.legs import Control
from woosh_robot_agent.vda5050.robot.status import serial_number
from woosh_robot_agent.vda5050.store import replace_file

_NOT_PAUSED = Sentence(
    "the robot did not pause and stop within {seconds} s; the pause is sent again until the robot "
    "stands, or until a stopPause"
)
_MEANWHILE = Sentence("a {action} arrived in the meantime")
_NOT_RESUMED = Sentence("the robot did not resume within {seconds} s")
_NO_ORDER = Sentence("there is no order to cancel")
_OTHER_ORDER = Sentence("the vehicle executes order {order}, not {given}")
_NOT_STORED = Sentence("the report cannot be stored: {error}")


@vehicle_action(START_PAUSE, INSTANT, "stop, and pause the order and its actions", repeatable=True)
async def start_pause(run: Run) -> None:
    """Pause the drive and the actions that move something."""
    execution, limit = run.execution, run.link.timing.pause_within
    execution.set_pause_wanted(True)

    def stands() -> bool:
        # without a link, people may let the robot go on with what it executes
        is_known = run.link.ready or not execution.is_executing
        return is_known and execution.paused and not execution.has_own_motion

    await run.wait(
        lambda: stands() or not execution.pause_wanted,
        limit,
        # the pause stays wanted after the failure, so that a robot that obeys late stops too
        _NOT_PAUSED(seconds=f"{limit:g}"),
    )
    if not execution.pause_wanted:
        raise ActionFailedError(_MEANWHILE(action=STOP_PAUSE))


@vehicle_action(STOP_PAUSE, INSTANT, "resume the order and its actions", repeatable=True)
async def stop_pause(run: Run) -> None:
    """Resume the drive and the paused actions, also if a button on the robot has paused them."""
    execution, limit = run.execution, run.link.timing.pause_within
    execution.drive.controller.adopt_pause()  # so that the end of a hold resumes the drive, too
    if execution.pause_wanted:
        execution.set_pause_wanted(False)
    elif execution.paused:  # by people at the robot, or the robot has refused to resume
        if not execution.order.held:  # a held drive is resumed at the end of the hold
            execution.drive.want(Control.RESUME)
        execution.calls.want(Control.RESUME)
        execution.tasks.want(Control.RESUME)

    def is_done() -> bool:
        return not execution.paused or execution.pause_wanted

    while not is_done():
        # without a link, this action waits without a limit: the robot resumes when the link is back
        await run.link.conditions.wait(lambda: run.link.ready or is_done())
        await run.wait(
            lambda: not run.link.ready or is_done(), limit, _NOT_RESUMED(seconds=f"{limit:g}")
        )
    if execution.pause_wanted:
        raise ActionFailedError(_MEANWHILE(action=START_PAUSE))


@vehicle_action(
    CANCEL_ORDER,
    INSTANT,
    "stop, and cancel the order",
    ParameterType(
        "orderId",
        "STRING",
        "order to cancel; any order if missing",
        optional=True,
        valid=bool,
        must_be=NOT_EMPTY,
    ),
    repeatable=True,
)
async def cancel_order(run: Run) -> None:
    """Cancel the current order, wait until everything has stopped, and empty the order.

    The instant actions that came before are cancelled, too, for they may move the robot. Without an
    order, nothing else is cancelled, and then the action fails, as the standard demands.
    """
    execution, order = run.execution, run.execution.order
    instant = execution.instant
    # after a last action whose end is unknown, only the error is left of the order
    has_order = bool(order.busy or order.error or execution.has_leftovers)
    if has_order and run.parameters.get("orderId", order.order_id) != order.order_id:
        raise ActionFailedError(
            _OTHER_ORDER(order=order.order_id, given=run.parameters["orderId"]),
            ErrorType.NO_ORDER_TO_CANCEL,
        )
    if has_order and not order.canceling:
        execution.cancel_order()
    instant.cancel_before(run.action.id)
    execution.cancel_leftovers()
    run.link.changed()  # sends the cancellation to the robot

    def is_done() -> bool:
        if instant.unfinished_before(run.action.id):
            return False
        stands = not execution.has_own_motion
        if order.canceling:
            return stands and order.has_ended and not execution.has_leftovers
        # there was no order, or another cancelOrder has emptied it; a new one may drive
        return stands or order.busy

    await run.link.conditions.wait(is_done)
    if order.canceling:
        order.empty()
    if not has_order:
        raise ActionFailedError(_NO_ORDER(), ErrorType.NO_ORDER_TO_CANCEL)


@vehicle_action("stateRequest", INSTANT, "publish the state", repeatable=True)
async def state_request(run: Run) -> None:
    """Publish the state."""
    run.reports.changed()


@vehicle_action("factsheetRequest", INSTANT, "publish the factsheet", repeatable=True)
async def factsheet_request(run: Run) -> None:
    """Publish the factsheet."""
    run.reports.publish_factsheet()


@vehicle_action(
    "clearInstantActions",
    NOT_ON_EDGES,
    "remove the instant actions that have ended from the state",
    repeatable=True,
    version="3",
)
async def clear_instant_actions(run: Run) -> None:
    """Forget the instant actions that have ended."""
    run.execution.instant.forget_ended()


_MAX_REPORTS = 100
"""Maximum number of reports of a robot; the oldest ones are deleted."""
_FILE_PREFIX = "log_report_"


@vehicle_action(
    "logReport",
    INSTANT,
    "store the state of the robot, its last tasks and status codes in a file",
    ParameterType("reason", "STRING", "reason, copied into the report"),
    result="path of the file in the folder of the reports",
    repeatable=True,
)
async def log_report(run: Run) -> str:
    """Store the reports of the robot in a file, and return its path in the log folder."""
    info, folder = run.execution.robot.info, run.log_folder
    assert folder is not None  # otherwise the vehicle lacks the action
    if info is None:
        raise ActionFailedError(NO_STATE())
    now = datetime.now(timezone.utc)
    content = {
        "time": now.isoformat(),
        "reason": run.parameters["reason"],
        "robot": _as_dict(info),
        "taskHistory": await _answer_or_reason(run, TaskHistory()),
        "statusCodes": await _answer_or_reason(run, StatusCodes()),
    }
    name = f"{_FILE_PREFIX}{now:%Y%m%dT%H%M%S_%f}.json"
    path = folder / serial_number(info) / name
    try:
        await asyncio.to_thread(_store, path, json.dumps(content, indent=1, ensure_ascii=False))
    except OSError as error:
        raise ActionFailedError(_NOT_STORED(error=str(error))) from None
    return str(path.relative_to(folder))


async def _answer_or_reason(run: Run, query: Message) -> dict[str, Any] | str:
    """Return the answer of the robot, or the reason why there is no answer."""
    try:
        answer = await run.link.ask(query)
    except LinkError as error:
        return str(error)
    if not answer.ok:
        return f"the robot refused {full_name(query)}: {answer.reason}"
    if answer.body is None:
        return f"{full_name(query)}: {answer.reason}"
    return _as_dict(answer.body)


def _as_dict(message: Message) -> dict[str, Any]:
    return MessageToDict(message, preserving_proto_field_name=True)


def _store(path: Path, text: str) -> None:
    """Write a report to a file, and delete the oldest reports beside it if there are too many.

    Raises:
        OSError: the report cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    others = sorted(path.parent.glob(f"{_FILE_PREFIX}*"))
    replace_file(path, text.encode())
    # the new one is not among them: after the clock was set back, its name is not the last
    for old in others[: 1 - _MAX_REPORTS]:
        old.unlink(missing_ok=True)
