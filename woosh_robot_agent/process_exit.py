"""End of a process with many ROS endpoints.

Fast DDS compares each endpoint that is destroyed with all others of its process: with the agents of
20 robots, that takes half a minute. When the process exits, it withdraws them all at once.
"""

from __future__ import annotations

import ctypes
import logging
import sys

from rclpy.utilities import get_rmw_implementation_identifier


def exit_withdraws_endpoints() -> bool:
    """Return whether the middleware tells other processes at exit that all endpoints are gone.

    Otherwise they would notice it only after a timeout, 20 s with DDS's defaults.
    """
    return str(get_rmw_implementation_identifier()).startswith("rmw_fastrtps")


def exit_process(status: int) -> None:
    """Exit without an end of the Python interpreter, which would destroy the endpoints.

    No callback of the middleware may need Python any more: shut the executor down before.

    Args:
        status: exit status of the process.
    """
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    # Unlike os._exit, this runs the exit functions of libraries, such as the middleware. PyDLL
    # keeps the interpreter's lock, so that no thread uses endpoints while they vanish.
    ctypes.PyDLL(None).exit(status)
