"""Calling the callbacks of consumers."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from woosh_robot_agent.link.codecs.frames import FrameError

_LOG = logging.getLogger(__name__)


def call(callback: Callable[[Any], None], argument: object) -> None:
    """Call a consumer's callback and log its exceptions.

    Raises:
        FrameError: the callback tried to read an invalid body.
    """
    try:
        callback(argument)
    except FrameError:
        raise
    except (Exception, asyncio.CancelledError):  # nothing is awaited: the callback raised it
        _LOG.exception("a callback failed")


def call_plain(callback: Callable[[], None]) -> None:
    """Call a consumer's callback that takes no argument, and log its exceptions."""
    try:
        callback()
    except Exception:
        _LOG.exception("a callback failed")
