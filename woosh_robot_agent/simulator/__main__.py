"""The simulated chassis as a program: `python3 -m woosh_robot_agent.simulator`."""

from __future__ import annotations

# Import nothing slow here: until `StopSignals` exists, a signal ends the program with a traceback.
import sys

from woosh_robot_agent.program import StopSignals, run_program

TYPE_CHECKING = False  # type checkers take it as True; so `typing` need not be imported
if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulator until SIGINT, SIGTERM or SIGHUP; return its exit status, 1 after an error.

    Args:
        arguments: command-line arguments; None for the arguments of this process. Then further
            signals are ignored at the end, because the process is about to end.
    """
    signals = StopSignals()

    def start() -> int:
        from woosh_robot_agent.simulator.command_line import run

        return run(arguments, signals)

    try:
        return run_program(start)
    finally:
        if arguments is None:
            signals.ignore()
        else:
            signals.restore()


if __name__ == "__main__":
    sys.exit(main())
