"""Start a tool: `python3 -m woosh_robot_agent.tools NAME ...`, or its entry point."""

from __future__ import annotations

# Import nothing slow here: until `run_program` runs, Ctrl-C ends a program with a traceback.
import importlib
import sys
from functools import partial

from woosh_robot_agent.program import run_program

TYPE_CHECKING = False  # as in `typing`, which loads slowly; type checkers know the name
if TYPE_CHECKING:
    from collections.abc import Sequence

_MODULES = {
    "dashboard": "dashboard.program",
    "doctor": "doctor.program",
    "maps": "maps.program",
    "monitor": "monitor.program",
    "record": "recording.record",
    "replay": "recording.replay",
}
"""Module of each program, which has the function `main`."""


def start(name: str, arguments: Sequence[str] | None = None) -> int:
    """Run the program `name`; return its exit status.

    The arguments are by default those of the command line, as for the `main` of each program.
    """

    def main() -> int:
        status: int = importlib.import_module(f"{__package__}.{_MODULES[name]}").main(arguments)
        return status

    return run_program(main)


# the entry points of the package, in the order of _MODULES
dashboard, doctor, maps, monitor, record, replay = (partial(start, name) for name in _MODULES)

if __name__ == "__main__":
    tool = sys.argv[1] if len(sys.argv) > 1 else ""
    if tool not in _MODULES:
        print(f"usage: python3 -m {__package__} {{{','.join(_MODULES)}}} ...", file=sys.stderr)
        print("error:", f"there is no tool {tool!r}" if tool else "name a tool", file=sys.stderr)
        sys.exit(2)
    sys.exit(start(tool, sys.argv[2:]))
