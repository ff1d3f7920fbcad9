"""What all actions have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.vda5050.model.factsheet import ActionType
from woosh_robot_agent.vda5050.model.order import Action
from woosh_robot_agent.vda5050.robot.facts import RobotFacts


class ActionFailedError(Exception):
    """An action failed. The text is the reason."""


class VehicleControls(Protocol):
    """What an action can do with the vehicle itself."""

    async def cancel_order(self, action_id: str) -> None:
        """Cancel the current order, and wait until everything has stopped.

        Args:
            action_id: id of the action that cancels it, for the error if there is no order.

        Raises:
            ActionFailedError: there is no order.
        """

    def publish_state(self) -> None:
        """Publish the state soon."""

    def publish_factsheet(self) -> None:
        """Publish the factsheet."""


@dataclass(frozen=True)
class Context:
    """Objects that all actions share.

    Attributes:
        chassis: the link; for requests that move nothing.
        gate: sends requests that move the robot.
        requests: addresses the requests.
        facts: what the robot reports.
        vehicle: the vehicle itself.
    """

    chassis: ChassisClient
    gate: MotionGate
    requests: RequestMaker
    facts: RobotFacts
    vehicle: VehicleControls


class Performer(Protocol):
    """An action that the vehicle can perform.

    Attributes:
        type: name, scopes and parameters, for the factsheet and for the check of orders.
    """

    type: ActionType

    def check(self, action: Action) -> str:
        """Return why an action with these parameters is impossible; empty if it is possible."""

    async def perform(self, action: Action) -> str:
        """Perform an action, and return its result; the result may be empty.

        When it is cancelled, it ends what it has begun at the robot.

        Raises:
            ActionFailedError: the action failed.
        """
