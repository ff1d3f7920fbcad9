"""The agent program: `ros2 run woosh_robot_agent agent`."""

from __future__ import annotations

# Import nothing slow here: until `StopSignals` exists, a signal ends the program with a traceback.
import sys

from woosh_robot_agent.standard_streams import open_standard_streams
from woosh_robot_agent.stop_signals import StopSignals

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_SPIN_TIMEOUT = 5.0
"""Maximum duration of an executor turn, in seconds.

A signal does not interrupt rclpy's wait. The link thread is notified at once, through
`StopSignals.fd`, and then ends the executor's turn.
"""
_CLOSE_SPIN_TIMEOUT = 0.05
"""Duration of one executor turn while the agents close, in seconds."""


def make_executor(name: str, context: Any = None) -> Any:
    """Return a new executor.

    Args:
        name: value of the parameter `executor`. rclpy has `events` since 7.1.4; older releases get
            `single` instead.
        context: rclpy context; by default the global one.
    """
    if name == "events":
        from woosh_robot_agent.ros_release import events_executor

        if (executor := events_executor(context)) is not None:
            return executor
        _warn_no_events_executor()
    from rclpy.executors import SingleThreadedExecutor

    return SingleThreadedExecutor(context=context)


def _warn_no_events_executor() -> None:
    import logging

    logging.getLogger("woosh_robot_agent.agent").warning(
        "this rclpy is older than 7.1.4 and has no EventsExecutor; using executor 'single' "
        "(executor:=single avoids this warning)"
    )


def main(args: list[str] | None = None) -> int:
    """Run the agents until SIGINT or SIGTERM; return the exit status.

    Further signals are ignored from then on, because the process is about to end.
    """
    open_standard_streams()
    signals = StopSignals()
    try:
        return _run(args, signals)
    finally:
        signals.ignore()


def _run(args: list[str] | None, signals: StopSignals) -> int:
    """Run the agents until a signal arrives; return the exit status."""
    from woosh_robot_agent.memory import (
        Heap,
        disable_collection,
        enable_collection_of_new_objects,
    )

    disable_collection()
    from woosh_robot_agent.library_versions import outdated_libraries

    if outdated := outdated_libraries():
        print("agent:", outdated, file=sys.stderr)
        return 2
    import rclpy
    from rclpy.exceptions import NameValidationException, ParameterException
    from rclpy.signals import SignalHandlerOptions

    from woosh_robot_agent.fleet import Fleet
    from woosh_robot_agent.process_exit import exit_process
    from woosh_robot_agent.rclpy_private import RCLError, UnknownROSArgsError
    from woosh_robot_agent.ros_release import error_text, exit_withdraws_endpoints

    heap = Heap()
    if signals.received:
        return 0
    try:
        try:
            # rclpy's handlers would shut the context down before goals and robot have been stopped
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            fleet = Fleet(lambda: signals.received)
        except (
            ValueError,
            ParameterException,
            NameValidationException,
            RCLError,
        ) as error:
            print("agent:", *error_text(error).split(), file=sys.stderr)
            return 2
        except UnknownROSArgsError as error:  # its text is the list of them
            print(f"agent: unknown arguments after --ros-args: {error}", file=sys.stderr)
            return 2
        executor = make_executor(fleet.executor)
        for agent in fleet.agents:
            executor.add_node(agent.node)
        fleet.begin_close_on(signals.fd)
        enable_collection_of_new_objects()
        while not signals.received and rclpy.ok():
            _spin_once(executor, _SPIN_TIMEOUT)
            heap.trim()
        # One robot ends quickly in any case, and a normal exit is safer.
        destroy = len(fleet.agents) == 1 or not exit_withdraws_endpoints()
        fleet.close(lambda: _spin_once(executor, _CLOSE_SPIN_TIMEOUT), destroy=destroy)
        executor.shutdown()  # an EventsExecutor keeps its entities in the ROS graph until then
        if not destroy:
            signals.ignore()  # `exit_process` does not return to `main`, which does it otherwise
            exit_process(0)
    finally:
        rclpy.try_shutdown()
    return 0


def _spin_once(executor: Any, timeout: float) -> None:
    """Run one executor turn; log the error of a callback, so that it does not end the agent."""
    import logging

    from rclpy.executors import ExternalShutdownException

    from woosh_robot_agent.logs import log_as

    log_as(None)  # until a callback sets the logger of its node
    try:
        executor.spin_once(timeout_sec=timeout)
    except ExternalShutdownException:
        pass
    except Exception:
        logging.getLogger("woosh_robot_agent.agent").exception("a callback failed")


if __name__ == "__main__":
    sys.exit(main())
