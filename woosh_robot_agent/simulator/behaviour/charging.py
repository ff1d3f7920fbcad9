"""The jobs that start and end charging."""

from __future__ import annotations

from dataclasses import replace

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.agenda import ROUNDING
from woosh_robot_agent.simulator.behaviour.jobs import Job, Progress, failed
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.behaviour.steps import Shift, Steps
from woosh_robot_agent.simulator.body.devices import Device


class Charge:
    """Charges at a charger.

    Depending on the profile, the job ends when the battery is full as defined by the settings, or
    some seconds after its start, although the battery goes on charging.
    """

    device = Device.CHARGER
    kind = util_action_pb2.kCharge

    def __init__(self) -> None:
        self._time = 0.0
        """Time since the start of the job, in seconds."""
        self._charges_on = False
        """True if the battery goes on charging after the end of the job."""

    def tick(self, robot: Robot, dt: float) -> Progress:
        if not robot.at_charger():
            return failed("not at a charger")
        profile = robot.profile.charging
        self._time += dt
        if self._time >= profile.starts_after - ROUNDING:
            robot.battery.charging = robot_pb2.Battery.kAuto
        if profile.confirmed_after is not None:
            self._charges_on = self._time >= profile.confirmed_after - ROUNDING
            return Progress(done=self._charges_on, text="charging")
        full = robot.setting.power.full
        if robot.battery.level >= full:
            return Progress(done=True, text=f"charged to {full} %")
        return Progress(text=f"at {robot.battery.percent} of {full} %")

    def suspend(self, robot: Robot) -> None:
        """End the charge, unless it goes on after the end of the job."""
        self._time = 0.0
        if not self._charges_on:
            robot.battery.charging = robot_pb2.Battery.kNot


class LeaveCharger:
    """Ends the charge, if there is one, and backs out of the charger, if the robot is in one."""

    device = Device.WHEELS
    kind = util_action_pb2.kSecondposQuit

    def __init__(self) -> None:
        self._way_out: Job | None = None

    def tick(self, robot: Robot, dt: float) -> Progress:
        robot.battery.charging = robot_pb2.Battery.kNot
        if self._way_out is None and not robot.at_charger():
            return Progress(done=True, text="not at a charger")
        self._way_out = self._way_out or back_out(robot)
        progress = self._way_out.tick(robot, dt)
        return replace(progress, text="left the charger") if progress.done else progress

    def suspend(self, robot: Robot) -> None:
        """Reset the timeout for obstacles."""
        if self._way_out:
            self._way_out.suspend(robot)


def back_out(robot: Robot) -> Job:
    """Return the job that drives a robot backwards out of a dock."""
    profile = robot.profile.charging
    distance = profile.docking_distance + sum(profile.steps)
    step = Shift(0.0, -distance, profile.docking_speed)
    return Steps([step], avoid=True, kind=util_action_pb2.kSecondposQuit)
