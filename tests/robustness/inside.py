"""The agent as a program that tells about itself: `python -m tests.robustness.inside --ros-args`.

A line on stdin asks, a line of JSON on stdout answers. The agent itself knows nothing of it: the
program is the one that users run, with a thread beside it.
"""

from __future__ import annotations

import asyncio
import gc
import json
import sys
import threading
from collections import Counter
from dataclasses import fields
from typing import Any

from woosh_robot_agent import agent, fleet, node

MOST_TYPES = 40
"""Types of which the objects are counted, those with the most first."""


class Watched(node.Agent):
    """The agent, with a thread that answers for it."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        threading.Thread(target=self._answer, name="watch", daemon=True).start()

    def _answer(self) -> None:
        for line in sys.stdin:
            state = asyncio.run_coroutine_threadsafe(self._look(), self._thread.loop).result()
            if "objects" in line:
                state["objects"] = _objects()
            print(json.dumps(state), flush=True)

    async def _look(self) -> dict[str, Any]:
        """What may grow with time, and what is counted; in the link's thread."""
        me = asyncio.current_task()
        connection, stats = self._chassis._connection, self._chassis.stats
        return {
            "tasks": len(asyncio.all_tasks() - {me}),
            "futures": 0 if connection is None else len(connection._pending),
            "pushes": len(self._chassis._subscriptions._queue._queue),
            "goals": self._actions.open_goals,
            "stats": {each.name: getattr(stats, each.name) for each in fields(stats)},
        }


def _objects() -> dict[str, int]:
    gc.collect()
    counts = Counter(type(each).__qualname__ for each in gc.get_objects())
    return {"all": sum(counts.values()), **dict(counts.most_common(MOST_TYPES))}


if __name__ == "__main__":
    fleet.Agent = Watched  # type: ignore[misc]
    sys.exit(agent.main())
