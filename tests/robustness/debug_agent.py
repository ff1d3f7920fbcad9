"""The agent as a program that prints its debug state on request.

    python -m tests.robustness.debug_agent --ros-args ...

The program answers each line on stdin with one line of JSON. The line `objects` adds the number of
Python objects by type. In all other respects it is the program that users run.
"""

from __future__ import annotations

from woosh_robot_agent.agent import Heap

Heap()  # as the agent does, before imports that start threads

# ruff: noqa: E402
import gc
import json
import sys
import threading
from collections import Counter
from typing import Any

from woosh_robot_agent import agent
from woosh_robot_agent.ros import fleet, node

_MAX_TYPES = 40
"""Number of types that are reported: those with the most objects."""


class DebugAgent(node.Agent):
    """The agent, with a thread that answers requests for its debug state."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        threading.Thread(target=self._answer, name="debug", daemon=True).start()

    def _answer(self) -> None:
        for line in sys.stdin:
            state = self.debug()
            if "objects" in line:
                state["objects"] = _count_objects()
            print(json.dumps(state), flush=True)


def _count_objects() -> dict[str, int]:
    gc.collect()
    counts = Counter(type(each).__qualname__ for each in gc.get_objects())
    return {"all": sum(counts.values()), **dict(counts.most_common(_MAX_TYPES))}


if __name__ == "__main__":
    fleet.Agent = DebugAgent  # type: ignore[misc]
    sys.exit(agent.main())
