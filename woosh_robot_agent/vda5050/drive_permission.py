"""Permission to start the drives of an order."""

from __future__ import annotations

from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.vda5050.actions.performer import RobotTasks
from woosh_robot_agent.vda5050.actions.robot_calls import RobotCalls
from woosh_robot_agent.vda5050.driving import Driver
from woosh_robot_agent.vda5050.messages.protocol import timestamp
from woosh_robot_agent.vda5050.messages.state import (
    ErrorType,
    OperatingMode,
    OrderStatus,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.orders.machine import OrderMachine
from woosh_robot_agent.vda5050.robot.facts import RobotFacts

_OTHER_MOTION = (
    "something else drives the robot",
    "wait for its end, or cancel the order",
)
"""Text about a motion that is not of the vehicle, and what to do."""
_OTHER_TASKS: dict[int | None, tuple[str, str]] = {
    task.kCharge: (
        "the robot executes a charging task that this vehicle has not started",
        "end it with stopCharging, or wait for its end; switch off automatic charging at the robot "
        "if the master control sends it to chargers",
    ),
    task.kParking: (
        "the robot executes a parking task that this vehicle has not started",
        "wait for its end; switch off automatic parking at the robot if the master "
        "control parks it",
    ),
}
"""The same for some types of tasks."""


class DrivePermission:
    """Decides from the state of the robot whether the order may start a drive.

    Args:
        chassis: the link.
        gate: tells what drives the robot.
        facts: what the robot reports.
        driver: drives the legs of the order.
        tasks: executes tasks of actions.
        calls: executes the robot's own actions.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        facts: RobotFacts,
        driver: Driver,
        tasks: RobotTasks,
        calls: RobotCalls,
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._facts = facts
        self._driver = driver
        self._tasks = tasks
        self._calls = calls

    def may_drive(self, machine: OrderMachine) -> bool:
        """Return True if the order may start a drive."""
        status = self._facts.status
        return (
            status is not None
            and status.mode is OperatingMode.AUTOMATIC
            and self._chassis.state is LinkState.READY
            and not self._tasks.task_id
            and not self.is_driven_otherwise(machine)
        )

    def is_driven_otherwise(self, machine: OrderMachine) -> bool:
        """Return True if something other than the order and its actions drives the robot."""
        if machine.driving or machine.acting:
            return False
        own = self._tasks.task_id
        if other := self._driver.other_task:
            return other != own
        return bool(self._gate.reported_owner) and not own and not self._calls.busy

    def errors(self, machine: OrderMachine) -> list[VehicleError]:
        """Return the reasons why the order or the robot waits, and the error of a lost link."""
        errors = []
        if self._chassis.state is not LinkState.READY:
            since = timestamp(self._chassis.since)
            errors.append(
                warning(
                    ErrorType.ROBOT_CONNECTION,
                    f"the link to the robot is lost; its last state is from {since}",
                    "check that the robot is on, and that the network reaches it",
                )
            )
        status = self._facts.status
        if status is not None and status.blocked:
            errors.append(
                warning(
                    ErrorType.OBSTACLE,
                    "an obstacle blocks the way of the robot",
                    "clear the way, and the robot drives on; or cancel the order",
                    **_place(machine.status),
                )
            )
        if machine.busy and self.is_driven_otherwise(machine):
            cause, hint = self._other_motion()
            errors.append(warning(ErrorType.ROBOT_BUSY, f"the order waits, because {cause}", hint))
        elif machine.busy and self._goes_on_charging(machine):
            errors.append(
                warning(
                    ErrorType.ROBOT_BUSY,
                    "the order waits, because the robot executes its charging task",
                    "end it with stopCharging, or wait for its end",
                )
            )
        return errors

    def _other_motion(self) -> tuple[str, str]:
        """Return what drives the robot besides this vehicle, and what to do about it."""
        info = self._facts.info
        kind = info.task_proc.type if info is not None and self._driver.other_task else None
        return _OTHER_TASKS.get(kind, _OTHER_MOTION)

    def _goes_on_charging(self, machine: OrderMachine) -> bool:
        """Return True if the task of an action continues after the action has ended."""
        return bool(self._tasks.task_id) and not machine.driving and not machine.acting


def _place(order: OrderStatus) -> dict[str, str]:
    """Return the references of an error to the order and its next node; none without an order."""
    return {"orderId": order.order_id, "nodeId": order.nodes[0].id} if order.nodes else {}
