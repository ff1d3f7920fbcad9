"""Actions of Nav2's behavior server: turns, straight moves, waits, and assisted teleoperation."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any

from woosh_robot_agent.motion import AnsweredCommand, VelocityDriver
from woosh_robot_agent.motion.requests import takes_wheels
from woosh_robot_agent.motion.timeliness import SenderClock
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros.action_pb2 import StepControl, kExecute
from woosh_robot_agent.robot.who_drives import command_name
from woosh_robot_agent.ros.actions.goal import Outcome
from woosh_robot_agent.ros.nav2.action import Nav2Action
from woosh_robot_agent.ros.nav2.goals import GoalEnd, Nav2Context, Nav2Goal, to_duration, to_seconds
from woosh_robot_agent.ros.nav2.pose import RobotPose
from woosh_robot_agent.ros.nav2.slots import DrivingSlot, velocity_objection
from woosh_robot_agent.ros.standard.cmd_vel import NUMBER, stamp_objection

_TURN_SPEED = 0.8
"""Speed of a turn, in rad/s, unless `cmd_vel_max_angular` is less."""


def _limit_time(goal: Nav2Goal) -> None:
    """End a goal at the end of its time_allowance; 0 or less is no limit."""
    seconds = to_seconds(goal.request.time_allowance)
    late = f"it has taken longer than its time_allowance of {seconds:g} s"
    goal.set_timeout(seconds, GoalEnd(late, "TIMEOUT"))


class _Travelled:
    """The distance and angle that the robot has travelled since this object was created."""

    def __init__(self, robot_pose: RobotPose) -> None:
        self._robot_pose = robot_pose
        self._start = self._last = robot_pose.pose
        self._turned = 0.0

    def distance(self) -> float:
        """Return the straight distance from the start, in metres.

        It is 0 while the pose is unknown, and always if it was unknown at the start.
        """
        pose, start = self._robot_pose.pose, self._start
        return 0.0 if pose is None or start is None else pose.seen_from(start).distance

    def turned(self) -> float:
        """Return the angle turned since the start, counter-clockwise, in radians.

        Call it often: between two calls, the robot must turn by less than half a revolution.
        """
        pose = self._robot_pose.pose
        if pose is not None and self._last is not None:
            self._turned += math.remainder(pose.theta - self._last.theta, math.tau)
        self._last = pose
        return self._turned


class _Behavior(Nav2Action):
    """An action whose goals are one step of StepControl each."""

    async def step(
        self, goal: Nav2Goal, tick: Callable[[], None], mode: Any, value: float, speed: float
    ) -> None:
        """Let the chassis make a step.

        Args:
            tick: called ten times a second, to publish feedback.
            mode: mode of the step, a `StepControl.Step.Mode`.
            value: length of the step, in metres or radians.
            speed: speed of the step, in m/s or rad/s.

        Raises:
            GoalEnd: the step was not made.
        """
        step = StepControl.Step(mode=mode, value=value, speed=speed)
        # its numbers have 32 bits, in which a large one is infinite
        if not (math.isfinite(step.value) and 0.0 < step.speed < math.inf):
            raise GoalEnd(
                f"a step of {value:g} at a speed of {speed:g} is not possible: check the goal, and "
                "cmd_vel_max_linear and cmd_vel_max_angular",
                "INVALID_INPUT",
            )
        _limit_time(goal)
        is_blind = getattr(goal.request, "disable_collision_checks", False)
        # avoid: 0 switches obstacle avoidance on, 1 off
        command = StepControl(action=kExecute, steps=[step], avoid=int(is_blind))
        await goal.run_command(command, tick=tick)


class Spin(_Behavior):
    """Turns on the spot."""

    name = "spin"

    async def execute(self, goal: Nav2Goal) -> None:
        if not goal.request.target_yaw:
            return  # the chassis takes 5 s to turn by nothing
        travelled = _Travelled(self.context.pose)
        speed = min(_TURN_SPEED, self.context.settings().velocity_limits.max_angular)
        await self.step(
            goal,
            lambda: goal.feedback(angular_distance_traveled=travelled.turned()),
            StepControl.Step.kRotate,
            goal.request.target_yaw,
            speed,
        )


class DriveOnHeading(_Behavior):
    """Drives a distance straight ahead or back."""

    name = "drive_on_heading"
    always_back = False
    """True if the robot drives back, whatever the signs of target and speed."""

    def validate(self, request: Any) -> None:
        target, speed = request.target, request.speed
        if (target.x > 0.0) != (speed > 0.0) and not self.always_back:
            raise GoalEnd(
                f"the target {target.x:g} and the speed {speed:g} have different signs",
                "INVALID_INPUT",
            )
        if target.y or target.z:
            raise GoalEnd(
                f"the robot drives straight only: the target has y {target.y:g} and z {target.z:g}",
                "INVALID_INPUT",
            )

    async def execute(self, goal: Nav2Goal) -> None:
        distance = goal.request.target.x
        if self.always_back:
            distance = -abs(distance)
        travelled = _Travelled(self.context.pose)
        limits = self.context.settings().velocity_limits
        speed = min(abs(goal.request.speed), limits.max_linear)
        await self.step(
            goal,
            lambda: goal.feedback(distance_traveled=travelled.distance()),
            StepControl.Step.kStraight,
            distance,
            speed,
        )


class BackUp(DriveOnHeading):
    """Drives straight back, whatever the signs of target and speed, as Nav2 does."""

    name = "backup"
    always_back = True


class Wait(Nav2Action):
    """Waits."""

    name = "wait"
    drives = False

    async def execute(self, goal: Nav2Goal) -> None:
        seconds = to_seconds(goal.request.time)
        await goal.run(
            asyncio.sleep(seconds),
            "wait",
            lambda: goal.feedback(time_left=to_duration(seconds - goal.elapsed)),
        )


class AssistedTeleop(Nav2Action):
    """Drives the robot by the velocities on cmd_vel_teleop, without obstacle avoidance.

    A goal without a time_allowance ends when the clients of the action have gone: otherwise, it
    would keep cmd_vel from driving the robot for ever.
    """

    name = "assisted_teleop"

    def __init__(self, context: Nav2Context, driving: DrivingSlot) -> None:
        super().__init__(context, driving)
        self._driver = VelocityDriver(
            context.gate,
            context.chassis,
            "cmd_vel_teleop",
            lambda: context.settings().velocity_limits,
            owner=self._other_owner,
        )
        context.gate.on_answered(self._answered)
        self._clock = SenderClock()
        """Estimates when a velocity was published, because late ones are not sent."""
        self._goal: Nav2Goal | None = None
        """The running goal."""
        stamped = context.settings().cmd_vel_stamped
        context.subscribe(
            "cmd_vel_teleop",
            self._drive,
            "geometry_msgs/TwistStamped" if stamped else "",
            with_info=True,
            urgent=True,
        )
        context.subscribe("preempt_teleop", self._preempt)

    async def run(self) -> None:
        """Send the velocities, until cancelled."""
        await self._driver.run()

    async def execute(self, goal: Nav2Goal) -> None:
        _limit_time(goal)
        is_unlimited = to_seconds(goal.request.time_allowance) <= 0.0
        had_clients = False  # until the middleware has discovered the first one

        def tick() -> None:
            nonlocal had_clients
            has_clients = self.server.has_clients
            if is_unlimited and had_clients and not has_clients:
                goal.stop(GoalEnd("its client has gone: send the goal again"))
            elif reason := self._reason_to_end():
                goal.stop(GoalEnd(reason))
            had_clients = has_clients
            goal.feedback(current_teleop_duration=to_duration(goal.elapsed))

        self._goal = goal
        try:
            await goal.wait_until(lambda: False, tick=tick)  # something else always ends the goal
        except Exception:  # a GoalEnd or a defect; if the agent ends, the gate stops the robot
            await self._driver.end()
            await self.context.pose.wait_until_standing()
            raise
        finally:
            self._goal = None

    def _reason_to_end(self) -> str:
        """Return why the robot does not obey velocities; empty if it does."""
        if refusal := self.context.chassis.refusal(Twist()):
            return refusal
        if (owner := self.context.gate.wheel_owner.name) and not self._overrides:
            return f"{owner} drives the robot"
        return velocity_objection(self.context.last_known.value(RobotInfo) or RobotInfo())

    def _answered(self, command: AnsweredCommand) -> None:
        """End the goal when the chassis accepts a drive: it may report the start a second later."""
        is_drive = command.answer.ok and takes_wheels(command.message)
        if is_drive and self._goal is not None and not self._overrides:
            self._goal.stop(GoalEnd(f"{command_name(command)} drives the robot"))

    @property
    def _overrides(self) -> bool:
        return self.context.settings().velocity_limits.override

    def _other_owner(self) -> str:
        """Return what drives the robot besides this action; empty if nothing does.

        It leaves out the goals of Nav2's actions, because the goal of this action is one of them.
        """
        owner = self.context.gate.wheel_owner.name
        return owner or ("a goal" if self.context.actions.running_goals else "")

    def _drive(self, message: Any, info: Any, taken: float) -> None:
        # a TwistStamped, if the parameter cmd_vel_stamped is true
        twist = getattr(message, "twist", message)
        values = (twist.linear.x, twist.linear.y, twist.angular.z)
        published = self._clock.of_message(info, taken)
        self._driver.note_number(info.get(NUMBER))
        if self._goal is None or self._goal.is_ending:
            # not sent, but after a stop, the driver has to know whether the sender pauses
            self._driver.note_received(any(values), published)
            return
        if twist is not message and (objection := stamp_objection(self.context, message)):
            self._driver.refuse("age", objection, published)
            return
        self._driver.drive(*values, published)

    def _preempt(self, _message: Any) -> None:
        """End the goal with success."""
        if self._goal is not None:
            self._goal.stop(GoalEnd(outcome=Outcome.SUCCEEDED))
