"""The private parts of rclpy that the agent needs, each with the public API that would replace it.

rclpy may change these names in any release. They are kept in this one module, so that a new release
is checked in one place. Ruff (TID251) forbids `rclpy.impl` everywhere else.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from typing import Any

from rclpy.action import ActionServer
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.logging import LoggingSeverity
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    Array,
    NamespacedType,
)

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


def keep_invalid_text(request_class: Any) -> None:
    """Let the texts of received requests show which of their bytes are not valid UTF-8.

    rclpy replaces such bytes by U+FFFD, which is also a legal character. Here, only that character
    itself becomes U+FFFD; an invalid byte becomes half a surrogate pair (`surrogateescape`), which
    no valid text has.

    Call it after the creation of a server, which loads the type's C functions; idempotent.

    Replaceable by: an argument of the generated conversions for the treatment of invalid bytes.
    """
    meta = type(request_class)  # holds the C functions
    if request_class in _conversions or not _fields_with_text(request_class):
        return
    original = _CONVERT(_pointer_of(meta._CONVERT_TO_PY, None))

    def convert(address: int) -> Any:
        message = original(address)
        _restore_text(message, address)
        return message

    _conversions[request_class] = replacement = _CONVERT(convert)
    meta._CONVERT_TO_PY = _capsule_of(ctypes.cast(replacement, ctypes.c_void_p), None, None)


_CONVERT = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
"""Type of the C function that creates a Python message from the C message at an address."""
_conversions: dict[Any, Any] = {}
"""The functions of `keep_invalid_text`, by class. C code calls them as long as the process runs."""
_pointer_of = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)
_capsule_of = ctypes.PYFUNCTYPE(
    ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
)(("PyCapsule_New", ctypes.pythonapi))
_NUMBERS: dict[str, Any] = {
    "boolean": ctypes.c_bool,
    "octet": ctypes.c_uint8,
    "float": ctypes.c_float,
    "double": ctypes.c_double,
    **{f"int{bits}": getattr(ctypes, f"c_int{bits}") for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": getattr(ctypes, f"c_uint{bits}") for bits in (8, 16, 32, 64)},
}
"""C types of the numbers in a message, by their names in the interface definition."""


class _Sequence(ctypes.Structure):
    """A text or a list in a C message."""

    _fields_ = (
        ("data", ctypes.c_void_p),
        ("size", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
    )


def _class_of(kind: Any) -> Any:
    outer, _, part = kind.name.partition("_")  # e.g. ExecTask_Goal of the action ExecTask
    found = getattr(import_module(".".join(kind.namespaces)), outer)
    return getattr(found, part) if part else found


def _fields(message_class: Any) -> Iterable[tuple[str, Any]]:
    """Return names and types of the fields."""
    names = message_class.get_fields_and_field_types()
    return zip(names, message_class.SLOT_TYPES, strict=True)


def _c_type(kind: Any) -> Any:
    """Return the C type of a field."""
    if isinstance(kind, AbstractString | AbstractSequence):
        return _Sequence
    if isinstance(kind, Array):
        return _c_type(kind.value_type) * kind.size
    if isinstance(kind, NamespacedType):
        return _c_message(_class_of(kind))
    return _NUMBERS[kind.typename]


@cache
def _c_message(message_class: Any) -> Any:
    """Return the C type of a message, which has the fields of the Python class in their order."""
    fields = [(name, _c_type(kind)) for name, kind in _fields(message_class)]
    # C has no structures without members
    members = {"_fields_": fields or [("empty", ctypes.c_uint8)]}
    return type(message_class.__name__, (ctypes.Structure,), members)


@cache
def _fields_with_text(message_class: Any) -> list[tuple[str, int, Any, int]]:
    """Return the fields that are or hold texts.

    Returns:
        Their names, their offsets in the C message, their types, or for lists those of the items,
        and for lists the size of an item in C, otherwise 0.
    """
    found = []
    for name, kind in _fields(message_class):
        item, size = kind, 0
        if isinstance(kind, AbstractSequence):
            item, size = kind.value_type, ctypes.sizeof(_c_type(kind.value_type))
        holds_text = isinstance(item, NamespacedType) and _fields_with_text(_class_of(item))
        if holds_text or isinstance(item, AbstractString):
            found.append((name, getattr(_c_message(message_class), name).offset, item, size))
    return found


def _restore_text(message: Any, address: int) -> None:
    """Set the texts of a message that have a U+FFFD from the bytes of the C message."""
    message_class: Any = type(message)
    for name, offset, item, size in _fields_with_text(message_class):
        value, at = getattr(message, name), address + offset
        if isinstance(item, AbstractString):
            if not size and "\ufffd" in value:
                setattr(message, name, _text_at(at))
            elif size and any("\ufffd" in text for text in value):
                begin = _Sequence.from_address(at).data
                setattr(message, name, [_text_at(begin + i * size) for i in range(len(value))])
        elif not size:
            _restore_text(value, at)
        elif value:
            begin = _Sequence.from_address(at).data
            for i, inner in enumerate(value):
                _restore_text(inner, begin + i * size)


def _text_at(address: int) -> str:
    data = ctypes.string_at(_Sequence.from_address(address).data)
    return data.decode("utf-8", "surrogateescape")


class DeferringActionServer(ActionServer):
    """An action server that executes a goal when told to, and counts clients that wait for results.

    rclpy calls `notify_execute` when a goal has become executing, and would then run the execute
    callback until the goal ends. Here `on_executing` is called instead, and `execute_later` runs a
    callback in the executor at the end of the goal.

    Each server has a clock of its own for the time for which results are kept. rclpy would use the
    node's, and the EventsExecutor prints a warning if many timers belong to one clock.

    Replaceable by: a goal handle whose result can be set from outside the execute callback, the
    number of pending result requests, and an argument for the clock.

    Args:
        node: owner of the server.
        arguments, options: the further ones of `rclpy.action.ActionServer`.

    Attributes:
        pending_results: clients that asked for the result of a goal and have not received it.
    """

    def __init__(self, node: Any, *arguments: Any, **options: Any) -> None:
        self.pending_results = 0
        creator = _NodeWithOwnClock(node)
        super().__init__(creator, *arguments, **options)
        keep_invalid_text(self._action_type.Impl.SendGoalService.Request)
        self._node = node
        self._clock = creator.get_clock()  # the C library does not keep it alive

    def on_executing(self, goal_handle: Any) -> None:
        """Take over a goal whose state has become executing."""
        raise NotImplementedError

    def execute_later(self, goal_handle: Any, callback: Callable[[Any], Any]) -> None:
        """Have the executor call `callback` with the goal; it returns the result. Thread-safe."""
        super().notify_execute(goal_handle, callback)

    def notify_execute(self, goal_handle: Any, _execute_callback: Any) -> None:
        self.on_executing(goal_handle)

    async def _execute_get_result_request(self, request_header_and_message: Any) -> None:
        if bytes(request_header_and_message[1].goal_id.uuid) in self._goal_handles:
            self.pending_results += 1
        await super()._execute_get_result_request(request_header_and_message)

    def _send_result_response(self, request_header: Any, future: Any) -> None:
        self.pending_results -= 1
        super()._send_result_response(request_header, future)


class _NodeWithOwnClock:
    """A node as its action server sees it while it is created: with another clock."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)

    def get_clock(self) -> Clock:
        return self._clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)
