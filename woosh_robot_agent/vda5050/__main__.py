"""Starts the connector: `python3 -m woosh_robot_agent.vda5050`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from woosh_robot_agent.program import run_program


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the connector, see `program.main`; tell how to install a library that is missing."""

    def run() -> int:
        from woosh_robot_agent.vda5050.program import main

        return main(arguments)

    return run_program(run)


if __name__ == "__main__":
    sys.exit(main())
