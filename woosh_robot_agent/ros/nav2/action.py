"""Base class of Nav2's actions: accepts their goals, and runs each one to its end."""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from typing import Any

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.ros.actions.goal import Outcome
from woosh_robot_agent.ros.actions.run import STOPPING
from woosh_robot_agent.ros.actions.server import Goal, GoalServer
from woosh_robot_agent.ros.nav2.goals import GoalEnd, Nav2Context, Nav2Goal, Replaced
from woosh_robot_agent.ros.nav2.slots import DrivingSlot, Slot
from woosh_robot_agent.ros.qos import RARE_QOS
from woosh_robot_agent.ros.standard_endpoints import BY_NAME

_LOG = logging.getLogger(__name__)


class Nav2Action(ABC):
    """One of Nav2's actions. Its goals run in the link thread.

    Args:
        driving: slot of the goals that move the robot.
    """

    name: str
    """Name of the action."""
    navigates = False
    """True if its goals are navigations of the chassis, which replace each other without a stop."""
    drives = True
    """False if its goals do not move the robot."""
    is_paused_by_emergency_stop = False
    """True if the emergency stop only pauses what the chassis executes for its goals, so that it
    could stay paused for ever, or drive on later."""

    def __init__(self, context: Nav2Context, driving: DrivingSlot) -> None:
        self.context = context
        self.action_type = class_of(BY_NAME[self.name].type, "action")
        self._slot = driving if self.drives else Slot()
        self._tasks: dict[asyncio.Task[None], Nav2Goal] = {}
        """The goals that have not ended, by the asyncio task that runs the goal."""
        self._logged_fields: set[str] = set()
        """Fields of which `log_unused` has logged that they have no effect."""
        self.server = GoalServer(
            context.node,
            context.thread,
            self.action_type,
            self.name,
            self._start,
            context.result_timeout,
            self.check,
            # a result with `error_msg` can tell the client why, which a rejection cannot
            rejects=not hasattr(self.action_type.Result, "error_msg"),
            services=RARE_QOS,
            feedback=RARE_QOS,
        )

    async def check(self, request: Any) -> None:  # noqa: B027 - most actions need no check
        """Check a goal before it is accepted, and transform its poses into the frame of the map.

        Raises:
            RejectedError: the goal cannot be executed. It is aborted if its result has a text, and
                otherwise rejected. The running goal goes on.
        """

    def validate(self, request: Any) -> None:  # noqa: B027 - most actions need no check
        """Check an accepted goal before it ends the running one.

        Raises:
            GoalEnd: the goal cannot be executed. The running goal goes on.
        """

    @abstractmethod
    async def execute(self, goal: Nav2Goal) -> None:
        """Execute a goal, and fill its result.

        Raises:
            GoalEnd: the goal is not reached.
            LinkError: the goal is not reached, because the chassis does not answer.
        """

    async def stop(self) -> None:
        """Abort the goals that have not ended."""
        tasks = dict(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for goal in tasks.values():  # a task that had not started has ended no goal
            goal.finish(GoalEnd(STOPPING))

    def log_unused(self, request: Any, field: str, default: Any = "") -> None:
        """Log once that a field has no effect, if a request sets it to other than its default."""
        if getattr(request, field, default) != default and field not in self._logged_fields:
            self._logged_fields.add(field)
            _LOG.info("%s: %s has no effect: the robot plans by itself", self.name, field)

    def _start(self, accepted: Goal) -> None:
        goal = Nav2Goal(
            accepted,
            self.context,
            self.name,
            self.action_type,
            navigates=self.navigates,
            is_paused_by_emergency_stop=self.is_paused_by_emergency_stop,
        )
        accepted.on_cancel(lambda: goal.stop(GoalEnd(outcome=Outcome.CANCELED)))
        task = start_task(self._run(goal, accepted.objection), name=f"nav2: {self.name}")
        if not task.done():  # it may have run to its end already
            self._tasks[task] = goal
            task.add_done_callback(self._tasks.pop)

    async def _run(self, goal: Nav2Goal, objection: str) -> None:
        """Run a goal to its end.

        Args:
            objection: why `check` objects to the goal; empty if it does not.
        """
        reason: GoalEnd | None = GoalEnd(STOPPING)  # if this is cancelled
        try:
            if objection:  # `check` objects only to poses that it cannot transform
                raise GoalEnd(objection, "TF_ERROR")
            goal.raise_if_ending()  # cancelled before it was accepted: the running goal goes on
            self.validate(goal.request)
            await self._slot.take(goal)
            await self.execute(goal)
            reason = None
        except (GoalEnd, LinkError) as end:
            reason = end if isinstance(end, GoalEnd) else GoalEnd(str(end))
            if reason.outcome is Outcome.ABORTED:
                level = logging.INFO if isinstance(reason, Replaced) else logging.WARNING
                _LOG.log(level, "%s: the goal is aborted: %s", self.name, reason)
        except Exception as error:
            _LOG.exception("%s failed", self.name)
            reason = GoalEnd(f"the agent failed: {error!r}; please report this")
        finally:
            goal.finish(reason)
