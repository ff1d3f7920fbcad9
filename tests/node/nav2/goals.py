"""Goals of Nav2's actions, from the client's side."""

from __future__ import annotations

import math
from typing import Any

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, PoseStamped

from tests.harness import Client, Collector, Logs, Robot, wait_future
from tests.node.goals import START
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.ros.standard_endpoints import BY_NAME
from woosh_robot_agent.simulator import SimulatorThread

SUCCEEDED = GoalStatus.STATUS_SUCCEEDED
CANCELED = GoalStatus.STATUS_CANCELED
ABORTED = GoalStatus.STATUS_ABORTED

PREVENTIONS = {
    "emergency stop": (
        lambda simulator: simulator.set_emergency_stop(True),
        lambda simulator: simulator.set_emergency_stop(False),
    ),
    "key switch": (
        lambda simulator: simulator.set_key_switch(True),
        lambda simulator: simulator.set_key_switch(False),
    ),
    "localisation": (
        lambda simulator: simulator.lose_localisation(),
        lambda simulator: simulator.call(
            lambda sim: setattr(sim.chassis.readiness, "located", True)
        ),
    ),
}
"""Functions that prevent the robot from driving, and that let it drive again."""


class Nav2Client:
    """A goal of one of Nav2's actions.

    Attributes:
        accepted: True if the server has accepted it.
        feedback: the feedback so far.
    """

    def __init__(self, client: Client, name: str, **fields: Any) -> None:
        self.feedback = Collector()
        self._client = client
        action = class_of(BY_NAME[name].type, "action")
        goal = action.Goal(**fields)
        self._has_text = hasattr(action.Result, "error_msg")
        server = client.action(action, name)
        sent = client.in_executor(
            lambda: server.send_goal_async(
                goal, feedback_callback=lambda message: self.feedback.add(message.feedback)
            )
        )
        self.handle = wait_future(sent)
        self.accepted: bool = self.handle.accepted
        self._result = client.in_executor(self.handle.get_result_async) if self.accepted else None

    def result(self) -> tuple[int, Any]:
        """Wait for the result; return its status (action_msgs/GoalStatus) and the message."""
        assert self._result is not None, "the goal was rejected"
        response = wait_future(self._result)
        return response.status, response.result

    def wait_aborted(self, *texts: str, code: str = "") -> Any:
        """Wait until the goal is aborted, with these texts and this error code; return the result.

        On Humble, results have no text and no code.
        """
        status, result = self.result()
        assert status == ABORTED, result
        for text in texts:
            assert text in getattr(result, "error_msg", text)
        if code and hasattr(result, "error_code"):
            constants = type(result)
            unknown = getattr(constants, "UNKNOWN", 0)
            assert result.error_code == getattr(constants, code, unknown)
        return result

    def refusal(self, logs: Logs) -> str:
        """Return why the goal was refused: the text of its result, or of the log.

        A goal whose result has no text is rejected, because a rejection has none either.
        """
        assert self.accepted is self._has_text
        if not self.accepted:
            return str(logs.wait_text("is rejected").getMessage())
        return str(self.wait_aborted(code="TF_ERROR").error_msg)

    @property
    def done(self) -> bool:
        """True if the result has been received."""
        return self._result is not None and bool(self._result.done())

    def cancel(self) -> Any:
        """Request a cancel; return the action_msgs/CancelGoal response."""
        return wait_future(self._client.in_executor(self.handle.cancel_goal_async))


def ahead(distance: float, frame: str = "map", left: float = 0.0) -> PoseStamped:
    """Return a pose in front of the initial pose of the simulated robot, with its heading."""
    x, y, theta = START
    cos, sin = math.cos(theta), math.sin(theta)
    return pose(x + cos * distance - sin * left, y + sin * distance + cos * left, theta, frame)


def pose(x: float, y: float, theta: float = 0.0, frame: str = "map") -> PoseStamped:
    """Return a pose as a message."""
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = x, y
    message.pose.orientation.z = math.sin(theta / 2)
    message.pose.orientation.w = math.cos(theta / 2)
    return message


def stands(simulator: SimulatorThread) -> bool:
    return not simulator.call(lambda sim: sim.chassis.base.moving)


def error_code(result: Any) -> int:
    """Return the error code of a result; 0 on Humble."""
    return int(getattr(result, "error_code", 0))


def go(client: Client, distance: float, **fields: Any) -> Nav2Client:
    """Send the robot to a pose in front of its initial one."""
    return Nav2Client(client, "navigate_to_pose", pose=ahead(distance), **fields)


def step(client: Client, name: str, distance: float, speed: float, allowance: int = 0) -> Any:
    """Send a goal of drive_on_heading or backup."""
    return Nav2Client(
        client,
        name,
        target=Point(x=distance),
        speed=speed,
        time_allowance=Duration(sec=allowance),
    )


def poses_field(action: Any, name: str, poses: list[PoseStamped]) -> Any:
    """Return the value of a field of several poses, which is a message since Kilted."""
    if "Goals" not in action.Goal.get_fields_and_field_types()[name]:
        return poses
    goals = class_of("nav_msgs/Goals")
    return goals(goals=poses)


def navigates(robot: Robot) -> bool:
    """Return True while the chassis executes MoveBase."""
    return robot.chassis.call(lambda sim: sim.chassis.actions.navigation) is not None
