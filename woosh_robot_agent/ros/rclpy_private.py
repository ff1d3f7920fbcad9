"""The private parts of rclpy that the agent needs, each with the public API that would replace it.

rclpy may change these names in any release. They are kept in this one module, so that a new release
is checked in one place. Ruff (TID251) forbids `rclpy.impl` everywhere else.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
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

    The public logger searches the call stack for that place. It would find the log handler, and
    take 60 ms for the first line of each caller.

    Replaceable by: a logger that takes the place as an argument.
    """
    if _rclpy.rclpy_logging_logger_is_enabled_for(logger_name, severity):
        _rclpy.rclpy_logging_rcutils_log(severity, logger_name, text, function, path, line)


WaitSet: Any = _rclpy.WaitSet
"""Waits for entities.

Replaceable by: a wait set exported by rclpy, or executors that look only at what is ready."""


def take_message(subscription: Any) -> tuple[Any, Any] | None:
    """Return the next message of a subscription and its info; None if no message waits.

    The message of a raw subscription is serialized, as bytes.

    Replaceable by: a `Subscription.take`.
    """
    handle = subscription.handle
    with handle:
        taken: tuple[Any, Any] | None = handle.take_message(subscription.msg_type, subscription.raw)
    return taken


def take_request(service: Any) -> tuple[Any, Any] | None:
    """Return the next request of a service and its header; None if no request waits.

    Replaceable by: a `Service.take`.
    """
    handle = service.handle
    with handle:
        taken = handle.service_take_request(service.srv_type.Request)
    request, header = taken or (None, None)  # rclpy gives no header if there is no request
    return None if header is None else (request, header)


def take_response(client: Any) -> Callable[[], None] | None:
    """Take the next response to a client; return a function that completes the call, or None.

    Replaceable by: a `Client.take`.
    """
    handle = client.handle
    with handle:
        header, response = handle.take_response(client.srv_type.Response)
    if header is None:
        return None
    try:
        future = client.get_pending_request(header.request_id.sequence_number)
    except KeyError:  # the client does not wait for it any more
        return None
    return partial(future.set_result, response)


@contextmanager
def undelivered_responses() -> Iterator[list[str]]:
    """Yield a list that gets the text of a warning for each response that rclpy drops meanwhile.

    rclpy drops a response if its client has not been discovered within 0.1 s, and only warns.
    Python's warnings are global, so responses of other threads count, too. The list is filled when
    the `with` block ends.

    Replaceable by: an exception, or a return value, of `Service.send_response`.
    """
    texts: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield texts
    texts += [text for each in caught if "send response" in (text := str(each.message))]


def call_timer(timer: Any) -> Callable[[], Any] | None:
    """Begin the next period of a timer; return its callback.

    None if the timer has been cancelled or reset meanwhile.

    Replaceable by: a `Timer.call`.
    """
    handle = timer.handle
    with handle:
        if not handle.is_timer_ready():
            return None
        handle.call_timer()
    callback: Callable[[], Any] | None = timer.callback
    return callback


def parameter_overrides(node: Any) -> dict[str, Any]:
    """Return the parameters that were set for a node at its start, declared or not, by name.

    Replaceable by: a public property of `Node`.
    """
    return dict(node._parameter_overrides)
