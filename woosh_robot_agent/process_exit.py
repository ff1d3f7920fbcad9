"""End of a process with many ROS endpoints.

Fast DDS compares each endpoint that is destroyed with all others of its process: with the agents of
20 robots, that takes half a minute. Fast DDS 2 also withdraws them all at once, when the process
exits (`ros_release.exit_withdraws_endpoints`).
"""

from __future__ import annotations

import ctypes
import logging
import sys
from typing import NoReturn


def exit_process(status: int) -> NoReturn:
    """Exit without finalizing the Python interpreter, which would destroy the endpoints one by one.

    Functions of `atexit` do not run. No callback of the middleware may need Python any more: shut
    the executor down before.

    Args:
        status: exit status of the process.
    """
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    # Unlike os._exit, this runs the exit functions of libraries, such as the middleware. PyDLL
    # keeps the interpreter's lock, so that no thread uses endpoints while they vanish.
    ctypes.PyDLL(None).exit(status)
    raise AssertionError("the C library did not exit")
