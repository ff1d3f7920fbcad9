"""Starts the connector: `python3 -m woosh_robot_agent.vda5050`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from woosh_robot_agent.program import run_program


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the connector, and return its exit status.

    If a library is missing, tell how to install it.

    Args:
        arguments: arguments of the program; by default from the command line.
    """

    def run() -> int:
        from woosh_robot_agent.vda5050.program import main

        return main(arguments)

    return run_program(run)


if __name__ == "__main__":
    sys.exit(main())
