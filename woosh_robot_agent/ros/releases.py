"""The differences between the supported releases of ROS: Humble, Jazzy and Kilted.

Each function or class here works alike on all of them. Its description tells which release needs
it, so that it can be dropped together with the support of that release. The differences of message
classes are in `convert.mapping.extra_slots`, because conversion does not import rclpy.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.exceptions import ParameterException
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.utilities import get_rmw_implementation_identifier

try:
    from rclpy.event_handler import (
        PublisherEventCallbacks,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )
except ImportError:  # Humble has the same classes under another name
    from rclpy.qos_event import (
        PublisherEventCallbacks,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )

__all__ = [
    "PublisherEventCallbacks",
    "SubscriptionEventCallbacks",
    "UnsupportedEventTypeError",
    "count_services",
    "error_text",
    "exit_withdraws_endpoints",
    "on_parameters_set",
    "subscriber_event_handlers",
    "this_computer_only",
    "type_hash",
]


def subscriber_event_handlers(node: Any, publisher: Any, callback: Callable[[], None]) -> Any:
    """Return new handlers that call `callback` when a subscriber of a publisher comes or goes.

    Humble has no such events, and neither has some middleware on the other releases.

    Raises:
        UnsupportedEventTypeError: there are no such events.
    """
    if "matched" not in inspect.signature(PublisherEventCallbacks).parameters:
        raise UnsupportedEventTypeError("this release has no matched events")
    callbacks = PublisherEventCallbacks(
        matched=lambda _change: callback(), use_default_callbacks=False
    )
    return callbacks.create_event_handlers(
        node.default_callback_group, publisher.handle, publisher.topic
    )


def exit_withdraws_endpoints() -> bool:
    """Return True if the middleware is known to withdraw all endpoints when the process exits.

    Fast DDS 2 of Humble and Jazzy does so. Fast DDS 3 of Kilted does not, because rmw_fastrtps
    keeps its factory of participants alive: other processes notice only after the lease duration,
    by default 20 s, that the endpoints are gone. Of other middleware, this is not known. If the
    result is False, destroy the nodes before the exit.
    """
    if not str(get_rmw_implementation_identifier()).startswith("rmw_fastrtps"):
        return False
    # rclpy does not tell the version of Fast DDS; the loaded library does
    return b"/libfastrtps.so.2" in Path("/proc/self/maps").read_bytes()


def on_parameters_set(
    node: Any, check: Callable[[list[Any]], Any], apply: Callable[[list[Any]], None]
) -> None:
    """Register callbacks for changes of a node's parameters.

    Humble has no callback for parameters that have been set. There, nothing can prevent a change
    any more once the last check has succeeded, so `apply` follows `check` right away.

    Args:
        node: owner of the parameters; it has no other callbacks for them.
        check: returns the `SetParametersResult` for changed parameters.
        apply: called with the changed parameters after a successful check.
    """
    if hasattr(node, "add_post_set_parameters_callback"):
        node.add_on_set_parameters_callback(check)
        node.add_post_set_parameters_callback(apply)
        return

    def check_and_apply(changed: list[Any]) -> Any:
        result = check(changed)
        if result.successful:
            apply(changed)
        return result

    node.add_on_set_parameters_callback(check_and_apply)


def count_services(node: Any, name: str) -> int:
    """Return the number of servers of a service.

    Humble cannot count them, so each node is asked for its services.

    Args:
        name: absolute name of the service.
    """
    if hasattr(node, "count_services"):
        return int(node.count_services(name))
    count = 0
    for each in node.get_node_names_and_namespaces():
        try:
            count += name in dict(node.get_service_names_and_types_by_node(*each))
        except NodeNameNonExistentError:  # it has just left the graph
            continue
    return count


def error_text(error: Exception) -> str:
    """Return the text of an error of rclpy.

    Errors of parameters have further arguments on Humble, where `str` returns all of them.
    """
    if isinstance(error, ParameterException) and error.args:
        return str(error.args[0])
    return str(error)


def type_hash(endpoint: Any) -> str:
    """Return the type hash of a publisher or subscription in the graph; empty on Humble."""
    return str(getattr(endpoint, "topic_type_hash", ""))


def this_computer_only() -> dict[str, str]:
    """Return the environment variables that keep ROS nodes on this computer.

    Humble has an older variable; later releases log a warning if it is set.
    """
    if hasattr(Node, "count_services"):  # Humble lacks it
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {"ROS_LOCALHOST_ONLY": "1"}
