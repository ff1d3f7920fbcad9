"""Slots: of the goals that share one, only the newest runs, and the goals before it end."""

from __future__ import annotations

from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pb2 import DeviceState, Mode, RobotInfo
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.readiness import CONTROL_MODES, EMERGENCY_STOP, objections
from woosh_robot_agent.ros.nav2.goals import GoalEnd, Nav2Goal, Replaced

_NO_LINK = "there is no link to the robot: send the goal again when the link is back"


class Slot:
    """Lets one goal run at a time: a new goal ends the goals before it."""

    def __init__(self) -> None:
        self._goals: list[Nav2Goal] = []
        """The last goal, and the goals that had not ended when it came; oldest first."""

    @property
    def running(self) -> list[Nav2Goal]:
        """The goals that have not ended, oldest first."""
        return [each for each in self._goals if not each.ended.done()]

    async def take(self, goal: Nav2Goal) -> None:
        """Let a goal run, and end the goals before it.

        If all of them are navigations, the chassis replaces the last one by the new one without a
        stop in between. Otherwise, the goals before are cancelled, and have ended when this
        returns.

        Raises:
            GoalEnd: the goal itself has ended meanwhile.
        """
        older = self.running
        self._goals = [*older, goal]
        if older and all(each.navigates for each in self._goals):
            # the last of them has already replaced or stopped those before it
            goal.replace(older[-1])
            return
        for each in older:
            each.stop(Replaced())
        for each in older:
            await goal.wait_until(each.ended.done, each.ended)


class DrivingSlot(Slot):
    """Lets one goal at a time move the robot.

    A goal for which the chassis executes nothing now, e.g. because it waits for the end of another
    goal, could move the robot later. So it ends when the link is lost, and when the robot reports a
    pressed emergency stop, or a control mode in which it obeys no velocity.

    Args:
        chassis: the link.
        gate: tells when the service `stop` is called.
        last_known: the last values that the chassis reported.
    """

    def __init__(self, chassis: ChassisClient, gate: MotionGate, last_known: LastKnown) -> None:
        super().__init__()
        self._chassis = chassis
        self._last_known = last_known
        gate.on_stop(self._stop_called)
        chassis.on_state(self._link_changed)
        chassis.on_snapshot(self._state_reported)
        # each report counts: a button may be pressed and released between two looks at the state
        chassis.subscribe(
            DeviceState, lambda each: self._state_reported(RobotInfo(device_state=each))
        )
        chassis.subscribe(Mode, lambda each: self._state_reported(RobotInfo(mode=each)))

    async def take(self, goal: Nav2Goal) -> None:
        if self._chassis.state is not LinkState.READY:
            raise GoalEnd(_NO_LINK)
        # a goal that need not wait is left to the chassis, which refuses it and says why
        info = self._last_known.value(RobotInfo) or RobotInfo()
        if self.running and (reason := velocity_objection(info)):
            raise GoalEnd(reason)
        await super().take(goal)

    def stop(self, reason: GoalEnd) -> bool:
        """End the goal that the chassis executes; return False if it executes none."""
        executing = [each for each in self.running if each.command is not None]
        for each in executing:
            each.stop(reason)
        return bool(executing)

    def _stop_called(self) -> None:
        """End all goals, because the service `stop` cancels what the chassis executes."""
        for each in self.running:
            each.send_no_more(GoalEnd("cancelled by the service stop"))

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            for each in self.running:
                if each.command is None:
                    each.stop(GoalEnd(_NO_LINK))

    def _state_reported(self, info: RobotInfo) -> None:
        """End goals if a report says that the robot obeys no velocity.

        A goal whose command the chassis executes ends with this command, and sends no further one.
        """
        reason = velocity_objection(info)
        if not reason:
            return
        for each in self.running:
            each.interruption = GoalEnd(reason)
            ends_now = each.is_paused_by_emergency_stop or each.command is None
            # a further cancel could end another task
            if ends_now and not each.is_stopped:
                each.stop(each.interruption)


def velocity_objection(info: RobotInfo) -> str:
    """Return why a robot obeys no velocity: emergency stop, control mode; empty if it does."""
    relevant = (EMERGENCY_STOP, *CONTROL_MODES)
    return "; ".join(str(each) for each in objections(info) if each in relevant)
