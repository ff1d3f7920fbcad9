"""Actions that end before they have begun."""

from __future__ import annotations

from typing import Any, cast

from tests.tools.waiting import aio, eventually
from tests.vda5050.orders import at, path
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.vda5050.actions.performing import Context
from woosh_robot_agent.vda5050.actions.runner import ActionRunner, action_types
from woosh_robot_agent.vda5050.execution import Execution
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import ActionStatus
from woosh_robot_agent.vda5050.messages.versions import V2_1
from woosh_robot_agent.vda5050.orders.legs import EndAction, Perform
from woosh_robot_agent.vda5050.robot.link import RobotLink, Timing


@aio
async def test_an_action_that_is_ended_before_it_begins_has_failed() -> None:
    link = RobotLink(LinkConfig(), Timing(), lambda: None, lambda: None)
    execution = Execution(link, V2_1, action_types(V2_1))
    runner = ActionRunner(Context(execution, cast("Any", None)))
    speak = Action("1", "speak", parameters={"text": "never said"})
    execution.order.moved(at(0.0))
    execution.order.receive(path("a", actions={"a": [speak]}))
    runner.obey(Perform(speak, at_once=True))
    runner.obey(EndAction(speak))
    await eventually(lambda: execution.order.status.actions[0].status is ActionStatus.FAILED)
    await link.close()
