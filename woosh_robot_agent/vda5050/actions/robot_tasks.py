"""Execution of tasks of the robot for actions, such as charging."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.vda5050.actions.conditions import Conditions
from woosh_robot_agent.vda5050.actions.errors import ActionFailedError
from woosh_robot_agent.vda5050.actions.pause import Pause
from woosh_robot_agent.vda5050.driving import UNKNOWN_TASK, Driver
from woosh_robot_agent.vda5050.model.errors import ErrorType
from woosh_robot_agent.vda5050.model.state import ActionStatus


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
