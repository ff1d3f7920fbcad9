"""Starts the connector: `python3 -m woosh_robot_agent.vda5050`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from woosh_robot_agent.program import import_problem

_LIBRARIES = ("aiomqtt", "jsonschema", "paho")
"""Libraries that are installed only for this program."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the connector; see `program.main`. Without its libraries, tell how to install them."""
    try:
        from woosh_robot_agent.vda5050.program import main as run
    except ImportError as error:
        if error.name in _LIBRARIES:
            problem = (
                f"vda5050 needs {error.name}, which is not installed here; install it with "
                "python3 -m pip install 'aiomqtt>=2.3' 'jsonschema>=4.20'"
            )
        elif not (problem := import_problem(error)):
            raise
        print(f"error: {problem}", file=sys.stderr)
        return 1
    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
