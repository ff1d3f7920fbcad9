"""Reasons why the chassis refused a request, from what it reports.

The answer to a refused request often says no more than "Request failed". The reason is in the state
of the robot, or in a status code that the chassis sends just after the answer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.readiness import (
    CONTROL_MODES,
    EMERGENCY_STOP,
    MAINTENANCE,
    NO_TASK,
    NOT_TASKABLE,
    Objection,
    busy,
    objections,
)
from woosh_robot_agent.status_codes import explained

CODE_DELAY = 0.1
"""Maximum time from a refusal to the status code that gives its reason, in seconds.

Real robots send the code within 50 ms.
"""


class RefusalExplainer:
    """Finds the reason of a refusal. Used in the event loop of the link.

    Args:
        chassis: the link, for status codes.
        last_known: last values that the chassis reported.
    """

    def __init__(self, chassis: ChassisClient, last_known: LastKnown) -> None:
        self._last_known = last_known
        self._refusals: list[_Refusal] = []
        """The refusals of the last `CODE_DELAY` seconds."""
        chassis.subscribe_raw(StatusCode, self._pushed)

    def reason(self, request_type: str) -> asyncio.Future[str]:
        """Find out why the chassis has just refused a request.

        Call it as soon as the answer has arrived, at best in its `tap`: earlier status codes are
        not considered.

        Args:
            request_type: protobuf full name of the request, e.g. `woosh.robot.ExecTask`. Instead of
                `woosh.ros.CallAction`, the name of its command is more precise, e.g.
                `woosh.ros.action.StepControl`.

        Returns:
            A future that gets the reason within `CODE_DELAY`; empty if the reason is not known.
        """
        # read now, because the state may have changed when the status code comes
        info = self._last_known.get(full_name(RobotInfo))
        find = _STATE_RULES.get(request_type)
        found = find(info) if find is not None and isinstance(info, RobotInfo) else []
        codes = (_WRONG_VERSION, *_CODES.get(request_type, ()))
        loop = asyncio.get_running_loop()
        refusal = _Refusal(loop.create_future(), "; ".join(each.reason for each in found), codes)
        self._refusals.append(refusal)
        loop.call_later(CODE_DELAY, self._end, refusal)
        return refusal.future

    def _end(self, refusal: _Refusal) -> None:
        """Stop to wait for a status code."""
        self._refusals.remove(refusal)
        refusal.tell("")

    def _pushed(self, body: Body) -> None:
        if not self._refusals:  # nearly always; then the body need not be decoded
            return
        code: StatusCode = body.message()
        for refusal in self._refusals:
            if str(code.code).startswith(refusal.codes):
                refusal.tell(f"status code {explained(code.code, code.msg)}")


@dataclass(frozen=True)
class _Refusal:
    """A refusal whose status code may still come.

    Attributes:
        future: gets the reason.
        state: the reasons in the state of the robot.
        codes: first digits of the status codes that can give the reason.
    """

    future: asyncio.Future[str]
    state: str
    codes: tuple[str, ...]

    def tell(self, code: str) -> None:
        """Complete the future with the reasons in the state and that of a status code, if any."""
        if not self.future.done():
            self.future.set_result("; ".join(filter(None, (self.state, code))))


def _for_task(info: RobotInfo) -> list[Objection]:
    return [*busy(info), *(each for each in objections(info) if each != NOT_TASKABLE)]


def _for_velocity(info: RobotInfo) -> list[Objection]:
    return [*busy(info), *_among(info, EMERGENCY_STOP, MAINTENANCE)]


def _for_change(info: RobotInfo) -> list[Objection]:
    """Return the reasons for a request that changes the mode, the map or the pose."""
    return [*busy(info), *_among(info, EMERGENCY_STOP, *CONTROL_MODES)]


def _for_order(info: RobotInfo) -> list[Objection]:
    found = _among(info, EMERGENCY_STOP, *CONTROL_MODES)
    return found if busy(info) else [*found, NO_TASK]


def _for_navigation(info: RobotInfo) -> list[Objection]:
    """Return the reasons for a request that changes the navigation of the running task."""
    return [] if busy(info) else [NO_TASK]


def _among(info: RobotInfo, *possible: Objection) -> list[Objection]:
    return [each for each in objections(info) if each in possible]


_TASKS = ("woosh.robot.ExecTask", "woosh.robot.ExecPreTask", "woosh.robot.ExecTaskSet")
_LIFTS = tuple(
    f"woosh.ros.action.{name}" for name in ("LiftControl", "LiftControl2", "LiftControl3")
)
_CALL, _STEP, _CHARGE, _MOVE = (
    "woosh.ros.CallAction",
    "woosh.ros.action.StepControl",
    "woosh.ros.action.ChargeControl",
    "woosh.ros.action.MoveBase",
)

_STATE_RULES: Mapping[str, Callable[[RobotInfo], list[Objection]]] = MappingProxyType(
    {
        **dict.fromkeys((*_TASKS, *_LIFTS, _CALL, _STEP, _CHARGE, _MOVE), _for_task),
        "woosh.robot.Follow": _for_task,
        "woosh.robot.Twist": _for_velocity,
        "woosh.robot.ActionOrder": _for_order,
        "woosh.robot.ChangeNavPath": _for_navigation,
        "woosh.robot.ChangeNavMode": _for_navigation,
        "woosh.robot.InitRobot": _for_change,
        "woosh.robot.SwitchMap": _for_change,
        "woosh.robot.SwitchWorkMode": _for_change,
    }
)
"""Functions that return the reasons in the robot's state, by type of the request."""

_WRONG_VERSION = "14080100001"
_NOT_AUTOMATIC = "14080100008"
_STEP_CODES = ("12030100002", "140506")
_LIFT_CODES = ("12400100002", "140502")
_CHARGE_CODES = ("12060100002", "140501")
_MOVE_CODES = ("140304",)
_CODES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        **dict.fromkeys(
            _TASKS, (_NOT_AUTOMATIC, "1408010001", "14080100020", "14080100021", "14080100026")
        ),
        **dict.fromkeys(_LIFTS, (_NOT_AUTOMATIC, *_LIFT_CODES)),
        _STEP: (_NOT_AUTOMATIC, *_STEP_CODES),
        _CHARGE: (_NOT_AUTOMATIC, *_CHARGE_CODES),
        _MOVE: (_NOT_AUTOMATIC, *_MOVE_CODES),
        _CALL: (_NOT_AUTOMATIC, *_STEP_CODES, *_LIFT_CODES, *_CHARGE_CODES, *_MOVE_CODES),
        "woosh.robot.Twist": (_NOT_AUTOMATIC, "14080100009"),
        "woosh.robot.Follow": (_NOT_AUTOMATIC, "14080100009"),
        "woosh.robot.ActionOrder": (_NOT_AUTOMATIC, "14080100027", "14080100028", "14080100029"),
        "woosh.robot.ChangeNavPath": ("14080100006", "14080100025"),
        "woosh.robot.ChangeNavMode": ("14080100007", "14030100001"),
        "woosh.robot.SwitchWorkMode": ("14080100002", "14080100003"),
        "woosh.robot.BuildMap": ("14080100004", "14080100005", "140701", "140702", "140703"),
        "woosh.robot.Deployment": ("14080100010",),
        "woosh.robot.SwitchMap": ("14080100022", "14070600001", "14070600002", "14070600003"),
        "woosh.robot.InitRobot": (
            *("14080100023", "14080100024", "14020100001"),
            *("14020100002", "14020100003", "14020100004"),
        ),
    }
)
"""First digits of the status codes that give the reason of a refusal, by type of the request.

The last digits are left out, because robots report some codes with another level than the table.
"""
