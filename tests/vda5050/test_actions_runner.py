"""Actions that end before they have begun."""

from __future__ import annotations

from typing import Any, cast

from tests.tools.waiting import aio, eventually
from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.actions.robot_calls import Pause
from woosh_robot_agent.vda5050.actions.runner import ActionRunner
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType


class Record:
    """Statuses of actions, in their sequence."""

    def __init__(self) -> None:
        self.statuses: list[ActionStatus] = []

    def action_changed(self, action_id: str, status: ActionStatus, result: str) -> None:
        self.statuses.append(status)

    def action_failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        pass


@aio
async def test_an_action_that_is_ended_before_it_begins_has_failed() -> None:
    record = Record()
    registry = Registry(cast(Any, None), "2.1.0")
    runner = ActionRunner(registry, Pause(), lambda: True, lambda: False, record)
    speak = Action("1", "speak", parameters={"text": "never said"})
    runner.start(speak)
    runner.end(speak)
    await eventually(lambda: record.statuses == [ActionStatus.FAILED])
    assert not runner.busy
    await runner.close()
