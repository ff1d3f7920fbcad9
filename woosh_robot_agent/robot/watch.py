"""The observers of one robot: they log, explain and warn, e.g. why a command was refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.pb.robot.robot_pb2 import DeviceState, Mode, RobotInfo
from woosh_robot_agent.robot.code_log import CodeLog, RefusalLog
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.readiness import EMERGENCY_STOP
from woosh_robot_agent.robot.refusals import RefusalExplainer
from woosh_robot_agent.robot.standstill import Standstill
from woosh_robot_agent.robot.who_drives import VelocitySources, WhoDrives


class Interruptions:
    """Tells when the emergency stop is pressed, and when the control mode changes.

    A sender that simply repeats its velocities must not move the robot after that.

    Attributes:
        is_pressed: True if the robot reports that its emergency stop is pressed.
    """

    def __init__(self, chassis: ChassisClient, gate: MotionGate) -> None:
        self.is_pressed = False
        self._control_mode: int | None = None
        """Control mode of the robot; None before its first report."""
        self._callbacks: list[Callable[[str], None]] = []
        chassis.on_snapshot(self._snapshot)
        chassis.subscribe(DeviceState, self._device_changed)
        chassis.subscribe(Mode, self._mode_changed)
        gate.on_answered(self._answered)

    def on_begin(self, callback: Callable[[str], None]) -> None:
        """Call `callback` with the reason of each interruption."""
        self._callbacks.append(callback)

    def _begin(self, reason: str) -> None:
        for callback in self._callbacks:
            callback(reason)

    def _snapshot(self, info: RobotInfo) -> None:
        self._device_changed(info.device_state)  # without one, nothing is pressed
        if info.HasField("mode"):
            self._mode_changed(info.mode)

    def _device_changed(self, state: DeviceState) -> None:
        self.is_pressed = bool(state.hardware & DeviceState.kEmgBtn)
        if self.is_pressed:
            self._begin(str(EMERGENCY_STOP))

    def _answered(self, command: AnsweredCommand) -> None:
        """Take the mode from an answer: its report may come after velocities that begin then."""
        mode = command.answer.body
        if isinstance(mode, Mode) and mode.ctrl:
            self._mode_changed(mode)

    def _mode_changed(self, mode: Mode) -> None:
        if self._control_mode not in (None, mode.ctrl):
            self._begin("the control mode of the robot has changed")
        self._control_mode = mode.ctrl


class Watch:
    """All observers of one robot. Used in the event loop of the link.

    Args:
        goals: returns the names of the goals that the chassis executes.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        last_known: LastKnown,
        explainer: RefusalExplainer,
        goals: Callable[[], Sequence[str]],
    ) -> None:
        CodeLog(chassis)  # the subscriptions of the link keep it alive
        RefusalLog(gate, explainer)  # the gate keeps it alive
        self.interruptions = Interruptions(chassis, gate)
        self.velocities = VelocitySources(gate)
        self.standstill = Standstill(chassis, gate, last_known)
        self.who_drives = WhoDrives(chassis, gate, last_known, self.velocities, goals)
