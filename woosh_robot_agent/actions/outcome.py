"""The outcome of a goal."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from google.protobuf.message import Message


class Outcome(Enum):
    """Final state of a goal, as in ROS."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


@dataclass(frozen=True)
class End:
    """Outcome and result of a goal, as sent to the client."""

    outcome: Outcome
    result: Message
    """Usually the chassis's last report on the goal."""
