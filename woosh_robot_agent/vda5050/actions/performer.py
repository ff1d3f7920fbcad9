"""Execution of an action by the vehicle, also as a task of the robot."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from google.protobuf.message import Message

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.link import Answer, ChassisClient
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.vda5050.actions.robot_calls import (
    ActionFailedError,
    Conditions,
    Objection,
    Pause,
    RobotCalls,
)
from woosh_robot_agent.vda5050.driving import UNKNOWN_TASK, Driver
from woosh_robot_agent.vda5050.messages.factsheet import ActionType
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType
from woosh_robot_agent.vda5050.robot.facts import RobotFacts
from woosh_robot_agent.vda5050.robot.maps import MapLibrary, RobotMarks


class RobotTasks:
    """Executes one task at a time.

    Args:
        chassis: the link; used in its event loop only.
        gate: sends the commands.
        requests: addresses the requests.
        pause: pauses and resumes the task.
        conditions: conditions of the vehicle.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
        pause: Pause,
        conditions: Conditions,
    ) -> None:
        self._conditions = conditions
        self._driver = Driver(
            chassis,
            gate,
            requests,
            self._ended,
            lambda: self._ended("there is no link to the robot"),
            self._changed,
        )
        self._end: asyncio.Future[str] | None = None
        """Done when the task has ended, with the reason why it failed; None without a task."""
        self._report: Callable[[ActionStatus], None] = lambda status: None
        self._closing = False
        pause.join(self._pause, self._is_paused)

    @property
    def task_id(self) -> int:
        """Id of the task that the robot executes for an action; 0 without one."""
        return self._driver.task_id

    async def perform(
        self,
        request: ExecTask,
        report: Callable[[ActionStatus], None],
        is_done: Callable[[], bool] = lambda: False,
    ) -> None:
        """Execute a task. When cancelled, cancel the task at the robot, and wait for its end.

        Args:
            request: the task; it gets a new id.
            report: called when the task begins, and when the robot pauses or resumes it.
            is_done: returns True if the action is finished before the end of the task.

        Raises:
            ActionFailedError: the task failed; of kind INTERRUPTED if its outcome is unknown.
        """
        if self._end is not None:
            raise ActionFailedError("the robot executes the task of another action")
        end: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._end, self._report = end, report
        self._driver.execute(request)
        report(ActionStatus.RUNNING)
        try:
            await self._conditions.wait(lambda: end.done() or is_done())
        except asyncio.CancelledError:
            if not self._closing:
                self._driver.cancel()
                await asyncio.wait({end})
            raise
        finally:
            self._end = None
        if end.done() and end.result():
            is_unknown = end.result() == UNKNOWN_TASK
            raise ActionFailedError(
                end.result(), ErrorType.INTERRUPTED if is_unknown else ErrorType.ACTION
            )

    async def close(self) -> None:
        """Stop waiting for answers; the robot goes on with its task."""
        self._closing = True
        await self._driver.close()

    def _ended(self, reason: str) -> None:
        if self._end is not None and not self._end.done():
            self._end.set_result(reason)
        self._conditions.check()

    def _changed(self) -> None:
        if self._end is not None:
            self._report(ActionStatus.PAUSED if self._driver.paused else ActionStatus.RUNNING)
        self._conditions.check()

    def _pause(self, pause: bool) -> None:
        if self._end is None:
            return
        if pause:
            self._driver.pause()
        else:
            self._driver.resume()

    def _is_paused(self) -> bool:
        return self._end is None or self._driver.stands


REACH = 3.0
"""Maximum distance of a mark at which an action docks, in metres; the master control has released
no way to a farther one."""
Report: TypeAlias = Callable[[ActionStatus], None]
"""Function that reports the status of an action while it is performed."""


class VehicleControls(Protocol):
    """Controls of the vehicle for actions."""

    @property
    def has_leg(self) -> bool:
        """True while the robot has a task to drive along the order, also while it is paused."""

    @property
    def paused(self) -> bool:
        """True while the vehicle is paused."""

    @property
    def at_rest(self) -> bool:
        """True unless the robot moves, by its last report, and nobody else drives it."""

    def order_has_action(self, action_id: str) -> bool:
        """Return True if an action of the order has this id."""

    def hold(self, name: str) -> None:
        """Stop the vehicle until the `release` of the same name."""

    def release(self, name: str) -> None:
        """End a hold; idempotent."""

    def resume(self) -> None:
        """Resume the drive that the robot, or another client, has paused."""

    def set_last_node(self, node_id: str) -> None:
        """Set the node on which the vehicle stands."""

    async def cancel_order(self, order_id: str) -> None:
        """Cancel the current order, wait until everything has stopped, and empty the order.

        Args:
            order_id: id that the order must have; empty for any order.

        Raises:
            ActionFailedError: there is no such order.
        """

    def publish_state(self) -> None:
        """Publish the state soon."""

    def publish_factsheet(self) -> None:
        """Publish the factsheet."""

    def clear_instant_actions(self) -> None:
        """Forget the instant actions that have ended."""


@dataclass(frozen=True)
class Context:
    """Objects that all actions share.

    Attributes:
        chassis: the link; for requests that move nothing.
        gate: sends requests that move the robot.
        requests: addresses the requests.
        facts: what the robot reports.
        maps: maps on the robot.
        marks: marks of the robot's scene.
        pause: the pause of the vehicle.
        conditions: waits for conditions of the vehicle.
        calls: executes the robot's own actions.
        tasks: executes tasks of the robot.
        vehicle: the vehicle itself.
    """

    chassis: ChassisClient
    gate: MotionGate
    requests: RequestMaker
    facts: RobotFacts
    maps: MapLibrary
    marks: RobotMarks
    pause: Pause
    conditions: Conditions
    calls: RobotCalls
    tasks: RobotTasks
    vehicle: VehicleControls

    async def request(self, message: Message) -> Answer:
        """Send a request that moves nothing, and return the answer.

        Raises:
            ActionFailedError: the robot refused it.
            LinkError: it was not sent or not answered.
        """
        answer = await self.chassis.request(self.requests.address(message))
        if not answer.ok:
            raise ActionFailedError(f"the robot refused {full_name(message)}: {answer.msg}")
        return answer

    def require_near(self, mark: str) -> None:
        """Check that the robot stands at a mark, or so near that it only has to dock.

        Raises:
            ActionFailedError: it does not, or the map has no such mark.
        """
        status = self.facts.status
        here = status.position if status is not None else None
        place = self.marks.find(mark, here.map_id) if here is not None else None
        if here is None or place is None:
            raise ActionFailedError(f"the robot knows no mark {mark} on its map")
        distance = math.hypot(place.x - here.x, place.y - here.y)
        if distance > REACH:
            raise ActionFailedError(
                f"mark {mark} is {distance:.1f} m away, more than {REACH:g} m: drive to it first"
            )

    def require_no_leg(self) -> None:
        """Check that the robot does not drive along an order.

        Raises:
            ActionFailedError: it does.
        """
        if self.vehicle.has_leg:
            raise ActionFailedError(
                "the vehicle drives along an order: wait until it stands on a node, or cancel it"
            )


class Performer(Protocol):
    """An action that the vehicle can perform.

    Attributes:
        type: name, scopes and parameters, for the factsheet and for the check of orders.
    """

    @property
    def type(self) -> ActionType: ...

    def check(self, action: Action) -> Objection | None:
        """Return why an action with these parameters is impossible; None if it is possible.

        The types of the parameters have been checked already.
        """

    async def perform(self, action: Action, report: Report) -> str:
        """Perform an action, and return its result; the result may be empty.

        When it is cancelled, it ends what it has begun at the robot.

        Args:
            action: the action.
            report: called with each change of the status between its start and its end.

        Raises:
            ActionFailedError: the action failed.
            LinkError: the robot could not be reached.
        """


class PlainPerformer:
    """Base of actions whose parameters need no check beyond their types."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def check(self, action: Action) -> Objection | None:
        """Return None: the types of the parameters have been checked."""
        return None
