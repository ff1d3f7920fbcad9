"""The outcome of a goal."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from google.protobuf.message import Message


class Outcome(Enum):
    """How a goal ends, in the terms of ROS."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


@dataclass(frozen=True)
class End:
    """The end of a goal, as the client gets it."""

    outcome: Outcome
    result: Message
    """Usually the chassis's last report on the goal."""
