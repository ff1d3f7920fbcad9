"""Reasons of rejected and failed actions."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.vda5050.model.errors import ErrorType


@dataclass(frozen=True)
class Objection:
    """A reason why the vehicle cannot perform an action.

    Attributes:
        reason: the reason.
        parameter: key of the wrong or missing parameter; empty if it is not about a parameter.
    """

    reason: str
    parameter: str = ""

    @property
    def references(self) -> dict[str, str]:
        """References for the error that reports it."""
        return {"actionParameter": self.parameter} if self.parameter else {}


class ActionFailedError(Exception):
    """An action failed. The text is the reason.

    Args:
        reason: the reason.
        kind: type of the error that reports it.
    """

    def __init__(self, reason: str, kind: ErrorType = ErrorType.ACTION) -> None:
        super().__init__(reason)
        self.kind = kind
