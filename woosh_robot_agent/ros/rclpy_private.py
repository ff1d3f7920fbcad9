"""The private parts of rclpy that the agent needs, each with the public API that would replace it.

rclpy may change these names in any release. They are kept in this one module, so that a new release
is checked in one place. Ruff (TID251) forbids `rclpy.impl` everywhere else.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.logging import LoggingSeverity

RCLError: Any = _rclpy.RCLError
"""Base class of the errors of the C library.

Replaceable by: an exception exported by `rclpy.exceptions`."""

UnknownROSArgsError: Any = _rclpy.UnknownROSArgsError
"""Raised by `rclpy.init` for ROS arguments that it does not know.

Replaceable by: an exception exported by `rclpy.exceptions`."""

PEER_GONE_ERRORS = (InvalidHandle, RCLError)
"""Raised when a reply or feedback is sent to a client that no longer exists."""


def log(
    logger_name: str, severity: LoggingSeverity, text: str, function: str, path: str, line: int
) -> None:
    """Log a text with a given place in the source.

    The public logger searches the call stack for that place: it would find the log handler, and
    takes 60 ms for the first line of each caller.

    Replaceable by: a logger that takes the place as an argument.
    """
    if _rclpy.rclpy_logging_logger_is_enabled_for(logger_name, severity):
        _rclpy.rclpy_logging_rcutils_log(severity, logger_name, text, function, path, line)


def replace_send_response(
    service: Any, replacement: Callable[[Any, Any], None]
) -> Callable[[Any, Any], None]:
    """Replace a service's `send_response`; return the original.

    The executor calls `send_response(response, header)` right after the callback. The header, which
    a later reply needs, is known only there.

    Replaceable by: service callbacks that get the header and reply later (deferred replies).
    """
    original: Callable[[Any, Any], None] = service.send_response
    service.send_response = replacement
    return original


def take_request(service: Any) -> tuple[Any, Any]:
    """Return the next pending request of a service and its header, or (None, None).

    Replaceable by: a `Service.take_request`, or executors that drain a service in one turn.
    """
    handle = service.handle
    with handle:
        return handle.service_take_request(service.srv_type.Request) or (None, None)


def take_with_info(executor: Any, wants_info: Callable[[Any], bool]) -> None:
    """Have an executor of Humble pass messages to some callbacks in a tuple with their information.

    Humble's executors take the information, e.g. the source time, and drop it.

    Replaceable by: any later release, whose executors pass it to callbacks with two arguments.

    Args:
        executor: the executor.
        wants_info: selects the callbacks.
    """

    def take(subscription: Any) -> Any:
        handle = subscription.handle
        with handle:
            taken = handle.take_message(subscription.msg_type, subscription.raw)
        return taken and (taken if wants_info(subscription.callback) else taken[0])

    executor._take_subscription = take


def parameter_overrides(node: Any) -> dict[str, Any]:
    """Return the parameters that were set for a node at its start, declared or not.

    Replaceable by: a public property of `Node`.
    """
    return dict(node._parameter_overrides)
