"""Detection of another connector that uses the topics of the same vehicle."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable

from woosh_robot_agent.vda5050.model.errors import (
    ErrorLevel,
    ErrorType,
    VehicleError,
)
from woosh_robot_agent.vda5050.model.state import ConnectionState

_LOG = logging.getLogger(__name__)
_QUIET = 40.0
"""Time without a sign of the other connector after which it counts as gone, in seconds; longer than
the pauses between its attempts to connect."""
_REASON = "another connector publishes as this vehicle, or connects with the same client id"


class OtherConnector:
    """Detects messages on the topic `connection` that this connector did not send.

    Two connectors of a vehicle have the same client id, so the broker disconnects one when the
    other connects. When it connects again, it receives the retained message of the other one.

    Args:
        is_own: returns True for the messages that this connector has sent.
        on_changed: called when another connector appears or disappears.

    Attributes:
        error: error to report; None if there is no other connector.
    """

    def __init__(self, is_own: Callable[[bytes], bool], on_changed: Callable[[], None]) -> None:
        self._is_own = is_own
        self._on_changed = on_changed
        self._connections = 0
        """Number of connections to the broker so far."""
        self._timer: asyncio.TimerHandle | None = None
        self.error: VehicleError | None = None

    def connected(self) -> None:
        """Take note of a new connection to the broker."""
        self._connections += 1
        if self.error is not None:  # its end may have been published meanwhile
            self._restart_timer()

    def received(self, payload: bytes, retained: bool) -> None:
        """Take a message on the topic `connection`."""
        state = _connection_state(payload)
        if state is None or self._is_own(payload):
            return
        if retained:
            if self._connections > 1:  # the first one may be of an earlier run
                self._restart_timer()
                self._found()
        elif state == ConnectionState.ONLINE.value:
            self._stop_timer()
            self._found()
        else:
            self._gone()

    def close(self) -> None:
        """Stop watching."""
        self._stop_timer()

    def _found(self) -> None:
        if self.error is None:
            hint = "end one of the two; until then the robot starts no drive"
            _LOG.error("%s; %s", _REASON, hint)
            self.error = VehicleError(
                ErrorType.SECOND_CONNECTOR.value, ErrorLevel.FATAL, _REASON, hint
            )
            self._on_changed()

    def _gone(self) -> None:
        self._stop_timer()
        if self.error is not None:
            _LOG.info("the other connector of this vehicle is gone")
            self.error = None
            self._on_changed()

    def _restart_timer(self) -> None:
        self._stop_timer()
        self._timer = asyncio.get_running_loop().call_later(_QUIET, self._gone)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _connection_state(payload: bytes) -> str | None:
    """Return the connectionState of a message; None if it has none."""
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    state = message.get("connectionState") if isinstance(message, dict) else None
    return state if isinstance(state, str) else None
