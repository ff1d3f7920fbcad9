"""Polls of what the chassis executes, for goals that it reports on with woosh.robot.TaskProc."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from woosh_robot_agent.actions.context import Context
from woosh_robot_agent.actions.kind import Findings
from woosh_robot_agent.link import Answer
from woosh_robot_agent.pb.robot.robot_pb2 import TaskHistory, TaskProc


async def poll_tasks(
    context: Context,
    found: Callable[[Findings], None],
    read_current: Callable[[TaskProc], Findings | None],
    read_history: Callable[[Iterable[TaskProc], TaskProc], Findings],
) -> None:
    """Ask for the current task, and for the ended ones if the current one is not of the goal.

    Args:
        context: objects shared by all tasks.
        found: called with what the polls found, as soon as an answer is read.
        read_current: reads the report on the current task; returns None if that is not of the goal.
        read_history: reads the last reports on ended tasks, given the current one too.

    Raises:
        LinkError: the chassis did not answer.
    """

    def tap_current(answer: Answer) -> None:
        current = answer.body
        if not answer.ok or not isinstance(current, TaskProc):
            found(Findings())
        elif (findings := read_current(current)) is not None:
            found(findings)

    answer = await context.chassis.request(context.empty(TaskProc), tap=tap_current)
    task = answer.body
    if not answer.ok or not isinstance(task, TaskProc) or read_current(task) is not None:
        return

    def tap_history(answer: Answer, current: TaskProc = task) -> None:
        known = answer.body.tes if answer.ok and isinstance(answer.body, TaskHistory) else ()
        found(read_history(known, current))

    await context.chassis.request(context.empty(TaskHistory), tap=tap_history)
