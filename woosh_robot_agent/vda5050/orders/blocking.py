"""Start of actions by their blocking types."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from woosh_robot_agent.vda5050.model.order import Action


def startable(waiting: Sequence[Action], running: Iterable[Action], *, driving: bool) -> int:
    """Return the number of waiting actions that may start now; they start in their order.

    Args:
        waiting: triggered actions, in the order in which they must start.
        running: actions that run.
        driving: True if the vehicle drives.
    """
    active = list(running)
    count = 0
    for action in waiting:
        if driving and action.blocking.stops:
            break
        if any(each.blocking.excludes_actions for each in active):
            break
        if active and action.blocking.excludes_actions:
            break
        active.append(action)
        count += 1
    return count
