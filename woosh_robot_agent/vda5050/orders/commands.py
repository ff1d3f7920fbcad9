"""Commands of the state machine of the order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from woosh_robot_agent.vda5050.model.order import Action
from woosh_robot_agent.vda5050.orders.legs import Leg


@dataclass(frozen=True)
class Drive:
    """Drive a leg, and report its end with `OrderMachine.drive_ended`."""

    leg: Leg


@dataclass(frozen=True)
class CancelDrive:
    """Cancel the drive, and report its end with `OrderMachine.drive_ended`."""


@dataclass(frozen=True)
class PauseDrive:
    """Pause the drive."""


@dataclass(frozen=True)
class ResumeDrive:
    """Resume the paused drive."""


@dataclass(frozen=True)
class Perform:
    """Perform an action, and report its progress with `OrderMachine.action_changed`."""

    action: Action


@dataclass(frozen=True)
class EndAction:
    """End an action that runs: the vehicle has left its edge, or the order was cancelled."""

    action: Action


Command: TypeAlias = Drive | CancelDrive | PauseDrive | ResumeDrive | Perform | EndAction
"""Any command of the state machine."""
