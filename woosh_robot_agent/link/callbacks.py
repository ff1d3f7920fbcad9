"""Calls of consumers' functions."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from woosh_robot_agent.link.codecs.frames import FrameError

_LOG = logging.getLogger(__name__)


def call(callback: Callable[[Any], None], argument: object) -> None:
    """Call a consumer's function and log its exceptions.

    Raises:
        FrameError: the consumer read a body that cannot be read.
    """
    try:
        callback(argument)
    except FrameError:
        raise
    except (Exception, asyncio.CancelledError):  # nothing is awaited here that could be cancelled
        _LOG.exception("a callback failed")
