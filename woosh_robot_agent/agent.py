"""The agent as a program: `ros2 run woosh_robot_agent agent`."""

from __future__ import annotations

# Nothing more is imported here: until `Signals` is there, a signal ends in a traceback.
import os
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_SPIN = 0.2
"""Maximum delay before the executor's thread notices a signal, in seconds.

A signal does not end rclpy's wait. The thread of the links is told at once, by `Signals.fd`.
"""


class Signals:
    """Notes SIGINT and SIGTERM from now on, instead of ending the program.

    Attributes:
        stop: True after the first signal.
        fd: a file descriptor that becomes readable with the first signal.
    """

    def __init__(self) -> None:
        self.stop = False
        self.fd, written = os.pipe()
        os.set_blocking(self.fd, False)
        os.set_blocking(written, False)
        signal.set_wakeup_fd(written, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, _signal: int, _frame: object) -> None:
        self.stop = True


def make_executor(name: str, context: Any = None) -> Any:
    """The executor called `name`; see the parameter `executor`.

    `single` takes the place of `events` where rclpy is older than 7.1.4 and has none.
    """
    if name == "events":
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            _warn_no_events()
        else:
            return EventsExecutor(context=context)
    from rclpy.executors import SingleThreadedExecutor

    return SingleThreadedExecutor(context=context)


def _warn_no_events() -> None:
    import logging

    logging.getLogger("woosh_robot_agent.agent").warning(
        "this rclpy has no EventsExecutor, which came with 7.1.4: the executor is 'single' instead"
    )


def main(args: list[str] | None = None) -> int:
    """Run the agents until SIGINT or SIGTERM. Returns the process's exit status."""
    signals = Signals()
    from woosh_robot_agent.memory import collect_nothing, collect_only_what_comes

    collect_nothing()
    import rclpy
    from rclpy.exceptions import NameValidationException, ParameterException
    from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
    from rclpy.signals import SignalHandlerOptions

    from woosh_robot_agent.fleet import Fleet
    from woosh_robot_agent.memory import give_back_large_blocks

    give_back_large_blocks()
    if signals.stop:
        return 0
    try:
        try:
            # rclpy's own handlers would shut the context down before goals and robot are settled
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            fleet = Fleet()
        except (
            ValueError,
            ParameterException,
            NameValidationException,
            _rclpy.RCLError,
            _rclpy.UnknownROSArgsError,
        ) as error:
            print("agent:", *str(error).split(), file=sys.stderr)
            return 2
        executor = make_executor(fleet.executor)
        for agent in fleet.agents:
            executor.add_node(agent.node)
        fleet.begin_close_on(signals.fd)
        collect_only_what_comes()
        while not signals.stop and rclpy.ok():
            _spin_once(executor, _SPIN)
        fleet.close(lambda: _spin_once(executor, 0.05))
        executor.shutdown()  # an EventsExecutor keeps what it listened to, and that in the graph
    finally:
        rclpy.try_shutdown()
    return 0


def _spin_once(executor: Any, timeout: float) -> None:
    """One turn; a mistake in a callback is logged, for it must not end the agent."""
    import logging

    from rclpy.executors import ExternalShutdownException

    from woosh_robot_agent.logs import speak_as

    speak_as(None)  # until a callback says whose it is
    try:
        executor.spin_once(timeout_sec=timeout)
    except ExternalShutdownException:
        pass
    except Exception:
        logging.getLogger("woosh_robot_agent.agent").exception("a callback failed")


if __name__ == "__main__":
    sys.exit(main())
