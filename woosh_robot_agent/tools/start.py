"""Start of the programs."""

from __future__ import annotations

# Import nothing slow here: until `program` runs, Ctrl-C ends the program with a traceback.
import importlib
import sys

from woosh_robot_agent.program import import_problem

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def program(module: str) -> Callable[..., int]:
    """Return the `main` of a program, which Ctrl-C ends without a traceback at any time.

    Args:
        module: Module with the `main` itself. It is imported when the program starts.
    """

    def main(arguments: Sequence[str] | None = None) -> int:
        try:
            status: int = importlib.import_module(module).main(arguments)
        except KeyboardInterrupt:
            return INTERRUPTED
        except ImportError as error:
            if not (problem := import_problem(error)):
                raise
            print(f"error: {problem}", file=sys.stderr)
            return 1
        return status

    return main
