"""The agent as a program that prints its debug state on request.

    python -m benchmarks.robustness.debug_agent --ros-args ...

The program answers each line on stdin with one line of JSON. In all other respects it is the
program that users run.
"""

from __future__ import annotations

from woosh_robot_agent.agent import Heap

Heap()  # as the agent does, before imports that start threads

# ruff: noqa: E402
import json
import sys
import threading
from typing import Any

from woosh_robot_agent import agent
from woosh_robot_agent.ros import fleet, node


class DebugAgent(node.Agent):
    """The agent, with a thread that answers requests for its debug state."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        threading.Thread(target=self._answer, name="debug", daemon=True).start()

    def _answer(self) -> None:
        for _ in sys.stdin:
            print(json.dumps(self.debug()), flush=True)


if __name__ == "__main__":
    fleet.Agent = DebugAgent  # type: ignore[misc]
    sys.exit(agent.main())
