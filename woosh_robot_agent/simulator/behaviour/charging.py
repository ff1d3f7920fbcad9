"""The jobs that start and end charging."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.behaviour.jobs import Progress, failed
from woosh_robot_agent.simulator.behaviour.robot import Robot
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
        if self._time >= profile.starts_after - 1e-9:
            robot.battery.charging = robot_pb2.Battery.kAuto
        if profile.confirmed_after is not None:
            self._charges_on = self._time >= profile.confirmed_after - 1e-9
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


class EndCharge:
    """Ends the current charge, if there is one."""

    device = Device.CHARGER
    kind = util_action_pb2.kCharge

    def tick(self, robot: Robot, dt: float) -> Progress:
        robot.battery.charging = robot_pb2.Battery.kNot
        return Progress(done=True, text="not charging")

    def suspend(self, robot: Robot) -> None:
        """Do nothing: the job ends in its first tick."""
