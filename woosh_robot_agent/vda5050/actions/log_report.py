"""The action that stores a report for troubleshooting."""

from __future__ import annotations

import asyncio
import json
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from google.protobuf.json_format import MessageToDict
from google.protobuf.message import Message

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCodes
from woosh_robot_agent.pb.robot.robot_pb2 import TaskHistory
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.vda5050.actions.errors import ActionFailedError
from woosh_robot_agent.vda5050.actions.performer import Context, PlainPerformer, Report
from woosh_robot_agent.vda5050.model.factsheet import ActionType, ParameterType, Scope
from woosh_robot_agent.vda5050.model.order import Action

_MAX_REPORTS = 100
"""Maximum number of reports of a robot; the oldest ones are deleted."""
_PREFIX = "log_report_"


class LogReport(PlainPerformer):
    """Stores what the robot reports, its last tasks and its last status codes as a JSON file.

    Args:
        context: objects that all actions share.
        folder: folder of the reports, with a subfolder for each robot.
    """

    type = ActionType(
        "logReport",
        frozenset({Scope.INSTANT}),
        "store the state of the robot, its last tasks and status codes in a file",
        (ParameterType("reason", "STRING", "reason, which the report repeats"),),
        "path of the file in the folder of the reports",
        repeatable=True,
    )

    def __init__(self, context: Context, folder: Path) -> None:
        super().__init__(context)
        self._folder = folder

    async def perform(self, action: Action, report: Report) -> str:
        requests, info = self._context.requests, self._context.facts.info
        if info is None:
            raise ActionFailedError("the robot has not reported its state yet")
        now = datetime.fromtimestamp(time.time(), timezone.utc)
        content = {
            "time": now.isoformat(),
            "reason": action.parameters["reason"],
            "robot": _as_dict(info),
            "taskHistory": await self._asked(requests.empty(TaskHistory)),
            "statusCodes": await self._asked(requests.empty(StatusCodes)),
        }
        folder = self._folder / str(info.genral.serial_number or info.robot_id)
        path = folder / f"{_PREFIX}{now:%Y%m%dT%H%M%S_%f}.json"
        try:
            await asyncio.to_thread(_store, path, json.dumps(content, indent=1, ensure_ascii=False))
        except OSError as error:
            raise ActionFailedError(f"the report cannot be stored: {error}") from None
        return str(path.relative_to(self._folder))

    async def _asked(self, query: Message) -> dict[str, Any] | str:
        """Return what the robot answers, or the reason why it does not."""
        try:
            answer = await self._context.chassis.request(query)
        except LinkError as error:
            return str(error)
        if not answer.ok or answer.body is None:
            return f"the robot refused {full_name(query)}: {answer.msg or answer.defect}"
        return _as_dict(answer.body)


def _as_dict(message: Message) -> dict[str, Any]:
    return MessageToDict(message, preserving_proto_field_name=True)


def _store(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    for old in sorted(path.parent.glob(f"{_PREFIX}*.json"))[:-_MAX_REPORTS]:
        old.unlink(missing_ok=True)
