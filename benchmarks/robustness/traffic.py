"""Traffic of a busy user of the agent, with a record of every request and its outcome.

Every command carries a unique mark (a text, a task id, a velocity or an angle). The marks in the
chassis's record of received messages show which commands it got, and how often.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from tests.harness import Client
from tests.node.goals import EXECUTE, lift_goal, short_task_goal, step_goal
from woosh_map_msgs.srv import SceneData, SceneDataEasy, SceneList, StorageStorages
from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot import robot_setting_pb2 as setting
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_msgs.action import ExecPreTask, ExecTask
from woosh_robot_msgs.msg import LED as LEDMsg
from woosh_robot_msgs.msg import Sound as SoundMsg
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import (
    LED,
    Battery,
    CountData,
    Mode,
    PlanNavPath,
    PoseSpeed,
    RobotInfo,
    SetSound,
    Speak,
    StatusCodes,
    TaskProc,
    Twist,
)
from woosh_ros_msgs.action import (
    ChargeControl,
    LiftControl,
    LiftControl2,
    NavigationMode,
    StepControl,
)

QUERIES = (
    (Mode, "robot/Mode"),
    (PoseSpeed, "robot/PoseSpeed"),
    (Battery, "robot/Battery"),
    (RobotInfo, "robot/RobotInfo"),
    (TaskProc, "robot/TaskProc"),
    (StatusCodes, "robot/StatusCodes"),
    (SceneDataEasy, "map/SceneDataEasy"),
    (SceneList, "map/SceneList"),
    (SceneData, "map/SceneData"),
    (StorageStorages, "map/storage/Storages"),
    (PlanNavPath, "robot/PlanNavPath"),
    (CountData, "robot/CountData"),
)
Mark = tuple[str, Any]
"""Short name of a message type, and a value that is unique among its commands."""
TASK_SETS = (666, 777)
"""Predefined task sets of the simulated robot."""
_UNLIMITED = 1_000_000
"""Maximum number of times that a cancel may reach the chassis."""


@dataclass
class Call:
    """One call of a service.

    Attributes:
        name: service and mark, for messages.
        future: future of the answer.
    """

    name: str
    future: Any


@dataclass
class TrackedGoal:
    """One goal. Only the client's executor changes it, because rclpy's clients are not thread-safe.

    Attributes:
        name: action and mark, for messages.
        cancel_mark: mark of its cancel at the chassis.
        cancels: number of times that its client asked to cancel it.
        handle: the client's goal handle, once the server has answered.
        result: future of the result, once the goal is accepted.
        error: why the goal failed within ROS; empty if it did not.
    """

    name: str
    cancel_mark: Mark
    cancels: int = 0
    handle: Any = None
    result: Any = None
    error: str = ""

    def accepted(self, future: Any) -> None:
        self.handle = future.result()
        if not self.handle.accepted:
            self.error = "the server did not accept the goal"
            return
        self.result = self.handle.get_result_async()
        if self.cancels:
            self.handle.cancel_goal_async()

    def cancel(self) -> None:
        self.cancels += 1
        if self.handle is not None and self.handle.accepted:
            self.handle.cancel_goal_async()

    @property
    def done(self) -> bool:
        return bool(self.error) or (self.result is not None and self.result.done())


class DuplicateAnswers:
    """Records answers to calls that were answered already, which rclpy drops silently.

    Attributes:
        found: service and sequence number of each duplicate.
    """

    def __init__(self) -> None:
        self.found: list[str] = []
        self._watched: set[Any] = set()

    def watch(self, service: Any) -> None:
        """Watch one rclpy client. Watching it again has no effect."""
        if service in self._watched:
            return
        self._watched.add(service)
        get_request = service.get_pending_request

        def get_once(sequence: int) -> Any:
            try:
                return get_request(sequence)
            except KeyError:
                self.found.append(f"{service.srv_name}, call {sequence}")
                raise

        service.get_pending_request = get_once


class Traffic:
    """The traffic of one scenario.

    Args:
        client: client of the agent.
        duplicates: watches the services that are called.
        marks: numbers for the marks, each used once per chassis.

    Attributes:
        calls: all calls of services.
        goals: all goals.
        allowed: number of times that each command may reach the chassis, by mark.
    """

    def __init__(self, client: Client, duplicates: DuplicateAnswers, marks: Iterator[int]) -> None:
        self.calls: list[Call] = []
        self.goals: list[TrackedGoal] = []
        self.allowed: Counter[Mark] = Counter()
        self._client = client
        self._duplicates = duplicates
        self._marks = marks

    # Requests. Each method returns at once

    def query(self, rng: random.Random) -> None:
        """Call one of the query services."""
        self._call(*rng.choice(QUERIES))

    def speak(self, _rng: random.Random | None = None) -> Call:
        """Let the robot say a unique text."""
        text = f"say {next(self._marks)}"
        return self._call(Speak, "robot/Speak", SpeakMsg(text=text), ("Speak", text))

    def set_sound(self, rng: random.Random) -> None:
        """Change the volume."""
        arg = SoundMsg(volume=rng.randint(0, 100))
        self._call(SetSound, "setting/Sound", arg, ("Sound", ""))

    def light(self, _rng: random.Random) -> None:
        """Give the lights a unique color."""
        color = next(self._marks)
        self._call(LED, "robot/LED", LEDMsg(color=color), ("LED", color))

    def twist(self, _rng: random.Random | None = None) -> None:
        """Let the robot drive slowly at a unique velocity."""
        mark = next(self._marks)
        linear = round((-1) ** mark * (0.01 + mark % 40_000 * 1e-6), 6)
        self._call(Twist, "robot/Twist", TwistMsg(linear=linear), ("Twist", linear))

    def task(self, rng: random.Random) -> None:
        """Let the robot go a short distance."""
        mark = next(self._marks)
        goal = short_task_goal(rng.uniform(0.2, 1.5), mark)
        self._goal(ExecTask, "robot/ExecTask", goal, ("ExecTask", mark), ("ActionOrder", ""))

    def step(self, rng: random.Random) -> None:
        """Let the robot turn by a unique angle."""
        angle = round(rng.randint(3, 30) / 10 + next(self._marks) % 90_000 * 1e-6, 6)
        self._action(StepControl, step_goal(angle), angle)

    def lift(self, rng: random.Random) -> None:
        """Move the lift."""
        self._action(LiftControl, lift_goal(rng.randint(1, 2)), "lift_control")

    def task_set(self, rng: random.Random) -> None:
        """Let the robot run a predefined task set."""
        goal = ExecPreTask.Goal()
        goal.arg.task_set_id = number = rng.choice(TASK_SETS)
        start, cancel = ("ExecPreTask", number), ("ActionOrder", "")
        self._goal(ExecPreTask, "robot/ExecPreTask", goal, start, cancel)

    def lift_column(self, _rng: random.Random) -> None:
        """Move the lift column to a unique height."""
        goal = LiftControl2.Goal()
        goal.arg.height = height = round(0.05 + next(self._marks) % 90_000 * 1e-6, 6)
        goal.arg.action.value = EXECUTE
        self._action(LiftControl2, goal, height)

    def charge(self, rng: random.Random) -> None:
        """Let the robot charge, or leave the charger."""
        goal = ChargeControl.Goal()
        goal.arg.execute_mode.value = rng.randint(1, 2)
        goal.arg.action.value = EXECUTE
        self._action(ChargeControl, goal, "charge_control")

    def navigation_mode(self, _rng: random.Random) -> None:
        """Limit the speed of the running navigation to a unique value."""
        goal = NavigationMode.Goal()
        goal.arg.mode.value = goal.arg.mode.K_ACCURATE_AVOID
        goal.arg.max_speed = speed = round(0.5 + next(self._marks) % 90_000 * 1e-6, 6)
        self._action(NavigationMode, goal, speed)

    def cancel(self, rng: random.Random) -> None:
        """Cancel one of the open goals, if there is one."""
        if self.open_goals:
            self.cancel_goal(rng.choice(self.open_goals))

    def cancel_goal(self, goal: TrackedGoal) -> None:
        """Cancel a goal. The agent may repeat the cancel until it gets through."""
        self.allowed[goal.cancel_mark] = _UNLIMITED
        self._client.executor.create_task(goal.cancel)

    # Outcome

    @property
    def open_calls(self) -> list[Call]:
        """Calls without an answer."""
        return [call for call in self.calls if not call.future.done()]

    @property
    def open_goals(self) -> list[TrackedGoal]:
        """Goals without a result."""
        return [goal for goal in self.goals if not goal.done]

    def _call(self, srv: Any, name: str, arg: Any = None, mark: Mark | None = None) -> Call:
        service = self._client.service(srv, name)
        self._duplicates.watch(service)
        request = srv.Request()
        if arg is not None:
            request.arg = arg
        if mark is not None:
            self.allowed[mark] += 1
        call = Call(name if mark is None else f"{name} {mark[1]}", service.call_async(request))
        self.calls.append(call)
        return call

    def _action(self, action: Any, goal: Any, mark: Any) -> None:
        """Send a goal of CallAction, whose start and cancel carry the same mark."""
        start, cancel = (("CallAction", (what, mark)) for what in ("execute", "cancel"))
        self._goal(action, f"ros/{action.__name__}", goal, start, cancel)

    def _goal(self, action: Any, name: str, goal: Any, start: Mark, cancel: Mark) -> None:
        self.allowed[start] += 1
        tracked = TrackedGoal(f"{name} {start[1]}", cancel)
        self.goals.append(tracked)
        client = self._client.action(action, name)
        self._client.executor.create_task(
            lambda: client.send_goal_async(goal).add_done_callback(tracked.accepted)
        )


def marks_of(message: Message) -> list[Mark]:
    """Return the marks of a message that the chassis received, as in `Traffic.allowed`.

    Queries and stops have none.
    """
    kind = message.DESCRIPTOR.name
    if isinstance(message, pack.Speak):
        return [(kind, message.text)]
    if isinstance(message, pack.ExecTask):
        return [(kind, message.task_id)]
    if isinstance(message, pack.LED):
        return [(kind, message.color)]
    if isinstance(message, pack.Twist):  # the agent may also send a stop on its own
        return [(kind, round(message.linear, 6))] if message.linear else []
    if isinstance(message, CallAction):
        return [(kind, _call_mark(message))]
    if isinstance(message, pack.ExecPreTask):
        return [(kind, message.task_set_id)]
    if isinstance(message, pack.ActionOrder | setting.Sound):
        return [(kind, "")]
    return []


def _call_mark(call: CallAction) -> tuple[str, Any]:
    member = str(call.WhichOneof("action"))
    command = getattr(call, member)
    # A setting has no action: it is always executed.
    what = "execute" if getattr(command, "action", EXECUTE) == EXECUTE else "cancel"
    if member == "step_control" and command.steps:
        return what, round(command.steps[0].value, 6)
    if member == "lift_control2":
        return what, round(command.height, 6)
    if member == "nav_mode":
        return what, round(command.max_speed, 6)
    return what, member
