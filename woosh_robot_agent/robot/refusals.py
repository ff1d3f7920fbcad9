"""Find out why the chassis refused a request, from its state and its status codes.

The answer to a refused request often says no more than "Request failed". The reason is in the state
of the robot, or in a status code that the chassis sends just after the answer.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import partial

from google.protobuf.message import Message

from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion.requests import TASK_REQUESTS, may_move
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask
from woosh_robot_agent.pb.util.robot_pb2 import kDeployMode
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.readiness import (
    CONTROL_MODES,
    EMERGENCY_STOP,
    MAINTENANCE,
    MANUAL,
    MAPPING,
    NO_TASK,
    NOT_DEPLOYMENT,
    NOT_TASKABLE,
    Objection,
    busy_objections,
    objections,
)
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.sentences import THEN, Sentence, joined

CODE_DELAY = 0.1
"""Maximum time from a refusal to the status code that gives its reason, in seconds.

Real robots send the code within 50 ms.
"""


_STATUS_CODE = Sentence("status code {code}")
_MANUAL = MANUAL._replace(
    reason="the robot is in manual mode, set by its key switch or by software"
)
"""`MANUAL`, but its reason says where the mode comes from."""
_MAX_REFUSALS = 50
"""Maximum number of refusals that wait for a status code."""


class RefusalExplainer:
    """Finds the reason of a refusal. Used in the event loop of the link."""

    def __init__(self, chassis: ChassisClient, last_known: LastKnown) -> None:
        self._last_known = last_known
        self._refusals: deque[_Refusal] = deque(maxlen=_MAX_REFUSALS)
        """The refusals of the last `CODE_DELAY` seconds, oldest first."""
        self._refusal_added = asyncio.Event()
        chassis.on_refused(self._refused)
        chassis.subscribe_raw(StatusCode, self._pushed)

    async def reason(self, request_type: str) -> str:
        """Return the reasons without their remedies as one text, empty if no reason is known."""
        return joined(THEN, (each.said for each in await self.reasons(request_type)))

    async def reasons(self, request_type: str) -> list[Objection]:
        """Return why the chassis has just refused a request, with the known remedies.

        Empty if no reason is known. Call it within `CODE_DELAY` after the answer. It returns at the
        end of this time, or as soon as the status code has come.

        Args:
            request_type: protobuf full name of the request, e.g. `woosh.robot.ExecTask`; for an
                action the full name of its command, e.g. `woosh.ros.action.StepControl`.
        """
        try:
            refusal = await run_with_timeout(CODE_DELAY, self._latest(request_type))
        except TimeoutError:
            return []
        code = await asyncio.shield(refusal.code)  # other calls may wait for it, too
        return [*refusal.state, code] if code else list(refusal.state)

    async def _latest(self, request_type: str) -> _Refusal:
        """Return the latest refusal of a type; wait until it comes out of the queue of pushes."""
        while True:
            for refusal in reversed(self._refusals):
                if refusal.type == request_type:
                    return refusal
            self._refusal_added.clear()
            await self._refusal_added.wait()

    def _refused(self, request: Message) -> None:
        """Note the state of the robot at a refusal, and expect a status code."""
        loop = asyncio.get_running_loop()
        refusal = _Refusal(type_of(request), self._state_reasons(request), loop.create_future())
        if len(self._refusals) == self._refusals.maxlen:
            self._refusals[0].end()  # the new one takes its place
        self._refusals.append(refusal)
        self._refusal_added.set()
        loop.call_later(CODE_DELAY, self._end, refusal)

    def _state_reasons(self, request: Message) -> list[Objection]:
        """Return the reasons in the state of the robot for which it refuses a request."""
        if isinstance(request, RepeatTask) and not may_move(request):
            return []  # it only edits a task set, which no state of the robot forbids
        find, info = _STATE_RULES.get(type_of(request)), self._last_known.value(RobotInfo)
        if find is None or info is None:
            return []
        return [_MANUAL if each == MANUAL else each for each in find(info)]

    def _end(self, refusal: _Refusal) -> None:
        """End the wait for the status code of a refusal."""
        refusal.end()
        if refusal in self._refusals:
            self._refusals.remove(refusal)

    def _pushed(self, body: Body) -> None:
        """Give a status code to the refusals that it explains."""
        if not self._refusals:  # nearly always; then the body need not be decoded
            return
        code: StatusCode = body.message()
        for refusal in self._refusals:
            if str(code.code).startswith((_WRONG_VERSION, *_CODES.get(refusal.type, ()))):
                text = _STATUS_CODE(code=explained(code.code, code.msg))
                refusal.end(Objection("status_code", text, ""))


@dataclass(frozen=True, eq=False)
class _Refusal:
    """A refusal whose status code may still come.

    Attributes:
        type: type of the request.
        state: the reasons in the state of the robot.
        code: future that gets the objection with the status code, or None if no code came in time.
    """

    type: str
    state: list[Objection]
    code: asyncio.Future[Objection | None]

    def end(self, code: Objection | None = None) -> None:
        """Set `code`, unless it is already set."""
        if not self.code.done():
            self.code.set_result(code)


def type_of(request: Message) -> str:
    """Return the protobuf full name of a request; for a CallAction, the name of its command."""
    if isinstance(request, CallAction) and (member := request.WhichOneof("action")):
        return full_name(getattr(request, member))
    return full_name(request)


# Functions that return the reasons in the robot's state, each for a kind of refused request

_STOP_OR_MODE = (EMERGENCY_STOP, *CONTROL_MODES)


def _for_task(info: RobotInfo) -> list[Objection]:
    """Return the reasons for a request that starts a task, an action or a following."""
    # NOT_TASKABLE would say no more than the refusal
    reasons = [each for each in objections(info) if each != NOT_TASKABLE]
    return [*busy_objections(info), *reasons]


def _among(possible: Container[Objection], info: RobotInfo) -> list[Objection]:
    """Return those of the possible objections that hold for the robot now."""
    return [each for each in objections(info) if each in possible]


def _busy_or_among(possible: Container[Objection], info: RobotInfo) -> list[Objection]:
    """Return what the robot is doing, and those of the possible objections that hold now."""
    return [*busy_objections(info), *_among(possible, info)]


def _for_mapping(info: RobotInfo) -> list[Objection]:
    """Return why the robot refuses to make a map now."""
    return [*_for_deployment(info), *_among(CONTROL_MODES, info)]


def _for_deployment(info: RobotInfo) -> list[Objection]:
    """Return why the robot refuses a request that needs the deployment mode now."""
    found = [each for each in busy_objections(info) if each != MAPPING]
    # A robot without a work mode is not in deployment mode either.
    if info.HasField("mode") and info.mode.work != kDeployMode:
        found.append(NOT_DEPLOYMENT)
    return found


def _for_order(info: RobotInfo) -> list[Objection]:
    """Return the reasons for an order to the running task, e.g. a pause."""
    found = _among(_STOP_OR_MODE, info)
    return found if busy_objections(info) else [*found, NO_TASK]


def _for_navigation(info: RobotInfo) -> list[Objection]:
    """Return the reasons for a request that changes the navigation of the running task."""
    return [] if busy_objections(info) else [NO_TASK]


TASK_TYPES = tuple(map(full_name, TASK_REQUESTS))
"""Protobuf full names of the requests that start a task."""
_LIFTS = tuple(
    f"woosh.ros.action.{name}" for name in ("LiftControl", "LiftControl2", "LiftControl3")
)
_STEP = "woosh.ros.action.StepControl"
_CHARGE = "woosh.ros.action.ChargeControl"
_MOVE = "woosh.ros.action.MoveBase"

_STATE_RULES: Mapping[str, Callable[[RobotInfo], list[Objection]]] = {
    **dict.fromkeys((*TASK_TYPES, *_LIFTS, _STEP, _CHARGE, _MOVE), _for_task),
    "woosh.robot.Follow": _for_task,
    "woosh.robot.Twist": partial(_busy_or_among, (EMERGENCY_STOP, MAINTENANCE)),
    "woosh.robot.ActionOrder": _for_order,
    "woosh.robot.ChangeNavPath": _for_navigation,
    "woosh.robot.ChangeNavMode": _for_navigation,
    "woosh.ros.action.NavigationMode": _for_navigation,
    "woosh.robot.InitRobot": partial(_busy_or_among, _STOP_OR_MODE),
    "woosh.robot.SwitchMap": partial(_busy_or_among, _STOP_OR_MODE),
    "woosh.robot.SwitchWorkMode": partial(_busy_or_among, _STOP_OR_MODE),
    "woosh.robot.SwitchControlMode": partial(_among, CONTROL_MODES),
    "woosh.robot.BuildMap": _for_mapping,
    "woosh.robot.Deployment": _for_deployment,
}
"""Functions that return the reasons in the robot's state, by type of the request."""

# First digits of status codes that several types of requests have
_WRONG_VERSION = "14080100001"
_NOT_AUTOMATIC = "14080100008"
_CODES: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(
        TASK_TYPES,
        # the second one stands for the ten codes 14080100010 to 14080100019
        (_NOT_AUTOMATIC, "1408010001", "14080100020", "14080100021", "14080100026"),
    ),
    **dict.fromkeys(_LIFTS, (_NOT_AUTOMATIC, "12400100002", "140502")),
    _STEP: (_NOT_AUTOMATIC, "12030100002", "140506"),
    _CHARGE: (_NOT_AUTOMATIC, "12060100002", "140501"),
    _MOVE: (_NOT_AUTOMATIC, "140304"),
    "woosh.robot.Twist": (_NOT_AUTOMATIC, "14080100009"),
    "woosh.robot.Follow": (_NOT_AUTOMATIC, "14080100009"),
    "woosh.robot.ActionOrder": (_NOT_AUTOMATIC, "14080100027", "14080100028", "14080100029"),
    "woosh.robot.ChangeNavPath": ("14080100006", "14080100025"),
    **dict.fromkeys(
        ("woosh.robot.ChangeNavMode", "woosh.ros.action.NavigationMode"),
        ("14080100007", "14030100001"),
    ),
    "woosh.robot.SwitchWorkMode": ("14080100002", "14080100003"),
    "woosh.robot.BuildMap": ("14080100004", "14080100005", "140701", "140702", "140703"),
    "woosh.robot.Deployment": ("14080100010",),
    "woosh.robot.SwitchMap": ("14080100022", "14070600001", "14070600002", "14070600003"),
    "woosh.robot.InitRobot": (
        "14080100023",
        "14080100024",
        "14020100001",
        "14020100002",
        "14020100003",
        "14020100004",
    ),
}
"""First digits of the status codes that give the reason of a refusal, by type of the request.

The last digits are left out, because robots report some codes with another level than the table.
"""
