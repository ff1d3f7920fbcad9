"""The agent program: `ros2 run woosh_robot_agent agent`."""

from __future__ import annotations

# Import nothing slow here: until `StopSignals` exists, a signal ends the program with a traceback.
import gc
import sys
import time

from woosh_robot_agent.program import (
    StopSignals,
    descriptor_problem,
    import_problem,
    open_standard_streams,
    outdated_libraries,
)

TYPE_CHECKING = False  # type checkers take it as True; so `typing` need not be imported
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any, NoReturn

_SPIN_TIMEOUT = 5.0
"""Maximum duration of an executor turn, in seconds.

A signal does not interrupt rclpy's wait. The link thread is notified at once, through
`StopSignals.fd`, and then ends the executor's turn.
"""
_CLOSE_SPIN_TIMEOUT = 0.05
"""Duration of one executor turn while the agents close, in seconds."""
_FAILED = 2
"""Exit status after an error that a restart does not mend, so that systemd does not restart it."""
_HELP = """\
usage: agent [-h] [--version] [--ros-args ...]

Drive a Woosh robot from ROS 2. Parameters are passed as ROS arguments:

  ros2 run woosh_robot_agent agent --ros-args -r __ns:=/woosh_robot -p ip:=172.20.8.74

ROS arguments that most robots need:
  -r __ns:=/NAME          namespace of the robot
  -p ip:=ADDRESS          address of the chassis (default: 169.254.128.2, over its own cable)
  -p port:=PORT           port of the chassis (default: that of the transport)
  -p publish_tf:=true     publish the transforms of the robot
  -p frame_prefix:=r1/    prefix of all frames, for several robots that share /tf
  -p observe_only:=true   never command the robot
  --params-file FILE      parameter file, for one robot or several

options:
  -h, --help              print this text
  --version               print the version

config/agent.yaml lists all parameters; it is installed in the folder that
"ros2 pkg prefix --share woosh_robot_agent" prints. The documentation is README.md
and docs/ in the source of the package."""
_EXAMPLE_ARGUMENTS = ("-p", "ip:=172.20.8.74")
"""ROS arguments that an error shows if it is unclear which ones were meant."""
_ROS_OPTION = (
    "-[epr]|--(param|remap|params-file|enclave|log-level|log-config-file"
    "|(en|dis)able-(rosout|stdout|external-lib)-logs)"
)
"""Pattern of the options that ROS takes after `--ros-args`."""


def main(args: list[str] | None = None) -> int:
    """Run the agents until SIGINT, SIGTERM or SIGHUP; return the exit status.

    After its return, these signals are ignored, because the process is about to end. `args` are by
    default the arguments of the command line.
    """
    open_standard_streams()
    if problem := descriptor_problem():
        print("agent:", problem, file=sys.stderr)
        return _FAILED
    signals = StopSignals()
    try:
        return _run(sys.argv[1:] if args is None else args, signals)
    except ImportError as error:
        if not (problem := import_problem(error)):
            raise
        print("agent:", problem, file=sys.stderr)
        return _FAILED
    finally:
        signals.ignore()


def _run(args: list[str], signals: StopSignals) -> int:
    """Run the agents until a signal arrives; return the exit status."""
    if own_arguments := _outside_ros_args(args):
        return _process_own_arguments(own_arguments)
    # Objects created at the start are mostly permanent. Searching them for garbage would take an
    # eighth of the start-up time.
    gc.disable()
    heap = Heap()  # before imports that start threads, such as numpy
    import rclpy

    if outdated := outdated_libraries():
        print("agent:", outdated, file=sys.stderr)
        return _FAILED
    from rclpy.exceptions import NameValidationException, ParameterException
    from rclpy.signals import SignalHandlerOptions

    from woosh_robot_agent.ros.executor import Executor
    from woosh_robot_agent.ros.fleet import Fleet
    from woosh_robot_agent.ros.logs import init_arguments
    from woosh_robot_agent.ros.rclpy_private import RCLError, UnknownROSArgsError
    from woosh_robot_agent.ros.releases import error_text, exit_withdraws_endpoints

    if signals.received:
        return 0
    try:
        try:
            # rclpy's handlers would shut the context down before goals and robot have been stopped
            rclpy.init(args=init_arguments(args), signal_handler_options=SignalHandlerOptions.NO)
            fleet = Fleet(stopping=lambda: signals.received)
        except (
            ValueError,
            ParameterException,
            NameValidationException,
            RCLError,
        ) as error:
            print("agent:", *error_text(error).split(), file=sys.stderr)  # on one line
            # 1: a restart may help after an error of the middleware, e.g. if the network was down
            return 1 if isinstance(error, RCLError) and rclpy.ok() else _FAILED
        except UnknownROSArgsError as error:  # its text is the list of the arguments
            print(f"agent: unknown arguments after --ros-args: {error}", file=sys.stderr)
            return _FAILED
        executor = Executor()
        for agent in fleet.agents:
            executor.add_node(agent.node)
        fleet.begin_close_on(signals.fd)
        gc.freeze()  # the objects that exist now are never searched
        gc.enable()
        while not signals.received and rclpy.ok():
            _spin_once(executor, _SPIN_TIMEOUT)
            heap.trim()
        # Destroying the endpoints is safer, but slow with several robots. They can be left to the
        # end of the process if the middleware withdraws them then.
        destroy = len(fleet.agents) == 1 or not exit_withdraws_endpoints()
        fleet.close(lambda: _spin_once(executor, _CLOSE_SPIN_TIMEOUT), destroy=destroy)
        executor.shutdown()
        if not destroy:
            signals.ignore()  # `main` would do so, but `_exit_process` does not return
            _exit_process()
    finally:
        rclpy.try_shutdown()
    return 0


def _outside_ros_args(args: list[str]) -> list[str]:
    """Return the arguments that ROS ignores: those outside of `--ros-args ... --`."""
    outside, in_ros_args = [], False
    for each in args:
        if each == "--ros-args":
            in_ros_args = True
        elif in_ros_args:
            in_ros_args = each != "--"
        else:
            outside.append(each)
    return outside


def _process_own_arguments(arguments: list[str]) -> int:
    """Print the help or the version, or refuse arguments; return the exit status."""
    if not {"-h", "--help"}.isdisjoint(arguments):
        print(_HELP)
        return 0
    if arguments == ["--version"]:
        print("agent", _version())
        return 0
    import shlex

    correct = shlex.join(["agent", "--ros-args", *_as_ros_args(arguments)])
    print(
        f"agent: unknown argument: {shlex.quote(arguments[0])}; pass parameters as ROS arguments, "
        f"e.g. {correct}; see agent --help",
        file=sys.stderr,
    )
    return _FAILED


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("woosh_robot_agent")
    except PackageNotFoundError:
        return "of unknown version, because the package is not installed"


def _as_ros_args(arguments: list[str]) -> Sequence[str]:
    """Return ROS arguments that the error message suggests: what was meant, or an example."""
    import re

    first, *rest = arguments
    if re.fullmatch(_ROS_OPTION, first):  # only `--ros-args` is missing
        return arguments
    try:
        from woosh_robot_agent.parameters import PARAMETERS
    except ImportError:  # without ROS
        return _EXAMPLE_ARGUMENTS
    # e.g. --ip=1.2.3.4, --ip 1.2.3.4 or ip:=1.2.3.4
    name, separator, value = first.lstrip("-").replace(":=", "=").partition("=")
    for each in PARAMETERS:
        if each.name == name.replace("-", "_"):
            if not separator:  # the value is the next argument, or missing
                missing = "true" if isinstance(each.default, bool) else "VALUE"
                value = rest[0] if rest and not rest[0].startswith("-") else missing
            return "-p", f"{each.name}:={value}"
    return _EXAMPLE_ARGUMENTS


def _spin_once(executor: Any, timeout: float) -> None:
    """Run one executor turn; log the error of a callback, so that it does not end the agent."""
    import logging

    from rclpy.executors import ExternalShutdownException

    from woosh_robot_agent.ros.logs import log_as

    log_as(None)  # until a callback sets the logger of its node
    try:
        executor.spin_once(timeout_sec=timeout)
    except ExternalShutdownException:
        pass
    except Exception:
        logging.getLogger("woosh_robot_agent.agent").exception("a callback failed")


_MIB = 1024 * 1024
_MMAP_THRESHOLD = 32 * _MIB
"""Size from which glibc maps a block separately, in bytes; the largest that glibc allows."""
_TRIM_THRESHOLD = 256 * _MIB
"""Size of the unused end of the heap above which glibc returns this end at once, in bytes.

Large, so that memory is usually returned by `Heap.trim`.
"""
_TRIM_PERIOD = 5.0
"""Time between two checks of the unused memory, in seconds."""
_TRIM_GROWTH = 8 * _MIB
"""Growth of the unused memory after which `Heap.trim` returns it to the system, in bytes."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Options of `mallopt`, from <malloc.h>."""


class Heap:
    """Settings of the C heap of this process. Create it before any thread.

    A large frame is copied several times on its way. Getting new memory from the system for each
    copy would take several times as long as the copying. Therefore the heap keeps freed memory, and
    `trim` returns it to the system shortly afterwards. All threads share one heap: glibc would not
    return the unused end of another one.

    Does nothing with other C libraries than glibc 2.33 and later.
    """

    def __init__(self) -> None:
        import ctypes

        class MallInfo(ctypes.Structure):
            """`struct mallinfo2` of <malloc.h>; `fordblks` is the unused memory in bytes."""

            _fields_ = (
                *((f"other{number}", ctypes.c_size_t) for number in range(8)),
                ("fordblks", ctypes.c_size_t),
                ("keepcost", ctypes.c_size_t),
            )

        libc: Any = ctypes.CDLL(None)
        self._libc = libc if hasattr(libc, "mallinfo2") else None
        if self._libc is not None:
            libc.mallopt(_M_ARENA_MAX, 1)
            libc.mallopt(_M_TRIM_THRESHOLD, _TRIM_THRESHOLD)
            libc.mallopt(_M_MMAP_THRESHOLD, _MMAP_THRESHOLD)
            libc.mallinfo2.restype = MallInfo
        self._due = time.monotonic() + _TRIM_PERIOD
        """Monotonic time of the next check."""
        self._untrimmable = self._unused()
        """Estimate of the unused memory that a trim cannot return, in bytes: small gaps between
        blocks in use."""

    def trim(self) -> None:
        """Return unused memory to the system if enough has gathered.

        Call this often: it checks only every `_TRIM_PERIOD`.
        """
        now = time.monotonic()
        if now < self._due or self._libc is None:
            return
        self._due = now + _TRIM_PERIOD
        unused = self._unused()
        if unused < self._untrimmable + _TRIM_GROWTH:
            # new blocks may have filled gaps, so that less is untrimmable
            self._untrimmable = min(self._untrimmable, unused)
            return
        self._libc.malloc_trim(0)
        self._untrimmable = self._unused()

    def _unused(self) -> int:
        """Return the unused memory of the heap, in bytes; 0 with other C libraries."""
        return 0 if self._libc is None else int(self._libc.mallinfo2().fordblks)


def _exit_process() -> NoReturn:
    """Exit without finalizing the Python interpreter, which would destroy the endpoints one by one.

    Fast DDS compares each endpoint that is destroyed with all others of its process: with the
    agents of 20 robots, that takes half a minute. Fast DDS 2 withdraws all endpoints at once when
    the process exits (`releases.exit_withdraws_endpoints`).

    Functions registered with `atexit` do not run. Shut the executor down first: no callback of the
    middleware may need Python any more.
    """
    import ctypes
    import logging

    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    # Unlike os._exit, this runs the exit functions of libraries, such as the middleware. PyDLL
    # keeps the interpreter's lock, so that no thread uses endpoints while they vanish.
    ctypes.PyDLL(None).exit(0)
    raise AssertionError("the C library did not exit")


if __name__ == "__main__":
    sys.exit(main())
