"""Definition of the vehicle's actions, and the object `Run` with which a function performs one."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.execution import Execution
from woosh_robot_agent.vda5050.messages.factsheet import ActionType, ParameterType, Scope
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import (
    NO_POSITION,
    NOT_READ,
    ROBOT_REFUSED,
    ActionFailedError,
    ActionStatus,
    Position,
)
from woosh_robot_agent.vda5050.reports import Reports
from woosh_robot_agent.vda5050.robot.link import RobotLink

_NO_MARK = Sentence("the robot knows no mark {mark} on its map")
_FAR = Sentence("mark {mark} is {distance} m away, more than {most} m: drive to it first")
_DRIVES = Sentence(
    "the vehicle drives along an order: wait until it stands on a node, or cancel it"
)
REACH = 3.0
"""Maximum distance from the robot to a mark at which an action docks, in metres. On the way to a
farther mark, the robot would leave the route that the master control has released."""
ANYWHERE = frozenset(Scope)
INSTANT = frozenset({Scope.INSTANT})
NOT_ON_EDGES = frozenset({Scope.INSTANT, Scope.NODE})
ON_NODES = frozenset({Scope.NODE})


@dataclass(frozen=True)
class Run:
    """An action that is being performed, and what its function needs to perform it.

    Attributes:
        report: call it with each change of the status between the start and the end of the action.
        execution: the order of the vehicle, and the state of the robot.
        log_folder: folder for the files of logReport; None if the vehicle does not have the action.
    """

    action: Action
    report: Callable[[ActionStatus], None]
    execution: Execution
    reports: Reports
    log_folder: Path | None

    @property
    def link(self) -> RobotLink:
        return self.execution.link

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Values of the parameters, by key; their types have been checked."""
        return self.action.parameters

    async def request(self, message: Message) -> Answer:
        """Send a request that moves nothing, and return the answer.

        Raises:
            ActionFailedError: the robot refused the request.
            LinkError: the request was not sent or not answered.
        """
        answer = await self.link.ask(message)
        if not answer.ok:
            raise ActionFailedError(ROBOT_REFUSED(what=full_name(message), reason=answer.reason))
        return answer

    async def call(self, command: Message) -> str:
        """Perform an action of the robot, e.g. StepControl, by `RobotCalls.perform`.

        First wait for the end of an action of the same kind: the robot executes one at a time.

        Returns:
            The text of the robot's last report on the action.

        Raises:
            ActionFailedError: the action failed.
        """
        calls = self.execution.calls
        await self.link.conditions.wait(lambda: self._is_permitted and not calls.executes(command))
        return await calls.perform(command, self.report)

    async def wait(self, condition: Callable[[], bool], timeout: float, failure: str) -> None:
        """Wait until a condition of the vehicle holds.

        Raises:
            ActionFailedError: the condition does not hold within `timeout` seconds; the text is
                `failure`.
        """
        if not await self.link.conditions.wait(condition, timeout):
            raise ActionFailedError(failure)

    @property
    def _is_permitted(self) -> bool:
        """False while the vehicle is paused, or has a second connector.

        Both may come after the action began.
        """
        return self.execution.is_only_connector and not self.execution.pause_wanted

    async def wait_until_permitted(self) -> None:
        """Wait while the vehicle is paused, or has a second connector."""
        await self.link.conditions.wait(lambda: self._is_permitted)

    async def wait_for_tasks(self) -> None:
        """Wait until the robot, which executes one task at a time, may begin the next one.

        It may not while the vehicle is paused, or has a second connector. When this returns, begin
        the task without waiting for anything else.

        Raises:
            ActionFailedError: the robot drives along an order.
        """
        execution = self.execution

        def may_start() -> bool:
            is_busy = execution.tasks.is_busy or execution.drive.is_late
            return self._is_permitted and not (is_busy or execution.is_leaving_task)

        await self.link.conditions.wait(lambda: execution.order.driving or may_start())
        self.require_not_driving_order()

    def require_position(self) -> Position:
        """Return the position of the robot.

        Raises:
            ActionFailedError: the robot does not know its position.
        """
        here = self.execution.robot.position
        if here is None or not here.initialised:
            raise ActionFailedError(NO_POSITION())
        return here

    def require_near(self, mark: str) -> None:
        """Check that the robot stands at a mark, or so near that it only has to dock.

        Raises:
            ActionFailedError: the robot is too far from the mark, it does not know its position,
                the map has no such mark, or the marks are not known yet.
        """
        here = self.require_position()
        maps = self.execution.maps
        place = maps.find_mark(mark, here.map_id)
        if place is None:
            raise ActionFailedError(_NO_MARK(mark=mark) if maps.knows_marks else NOT_READ())
        distance = math.dist(place.point, here.point)
        if distance > REACH:
            away = f"{distance:.1f}"
            raise ActionFailedError(_FAR(mark=mark, distance=away, most=f"{REACH:g}"))

    def require_not_driving_order(self) -> None:
        """Check that the robot does not drive along an order.

        Raises:
            ActionFailedError: the robot drives along an order.
        """
        if self.execution.order.driving:
            raise ActionFailedError(_DRIVES())


PerformFunction: TypeAlias = Callable[[Run], Awaitable[str | None]]
"""Coroutine function that performs an action, and returns its result, if it has one.

When the coroutine is cancelled, it ends what it has begun at the robot. It raises an
ActionFailedError if the action failed, and a LinkError if the robot could not be reached.
"""


@dataclass(frozen=True)
class VehicleAction:
    """An action that the vehicle can perform.

    Attributes:
        type: name, scopes and parameters, for the factsheet and for the check of orders.
        version: major number of the only version of the standard that has the action, e.g. `3`;
            empty if all versions have it.
    """

    type: ActionType
    perform: PerformFunction
    version: str = ""


def vehicle_action(
    name: str,
    scopes: frozenset[Scope],
    description: str,
    *parameters: ParameterType,
    version: str = "",
    **options: Any,
) -> Callable[[PerformFunction], VehicleAction]:
    """Return a decorator that makes a function an action.

    Args:
        version: as in `VehicleAction`.
        options: further attributes of `ActionType`, as are the other arguments.
    """
    kind = ActionType(name, scopes, description, parameters, **options)
    return lambda perform: VehicleAction(kind, perform, version)
