"""Refusals of requests: an explanation for people, the words of the real robot, a status code.

The profile decides which of the three are sent. This module has the refusals for which the real
robot has special words or a status code, and the refusals that several handlers share. All other
refusals are in the handlers: a `RefusedError` with an explanation.
"""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.simulator import status_codes as codes
from woosh_robot_agent.simulator.status_codes import Code

REQUEST_FAILED = "Request failed"
"""Words for most refusals. They give no reason."""

TASK_IS_EXECUTING = "Task is excuting,request failed"
"""Words for a request that a running task forbids. The misspelling is that of the real robot."""

NOT_AUTO_MODE = "It is not auto mode,request failed"
"""Words for a request that needs automatic mode."""

NOT_TASK_MODE = "It is not task or dispatch mode,request failed"
"""Words for a request that needs another work mode."""

NO_TWIST = "State not allow to twist"
"""Words for a velocity that the state of the robot forbids."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """A situation in which the robot refuses a request.

    Attributes:
        explanation: what is wrong; usually followed by a colon and what to do. A template for
            `str.format`.
        words: text of the real robot's answer.
        code: status code that follows the answer of the real robot; None if there is none.
        harmless: True if the request merely has no effect. With a profile that explains refusals,
            it is then answered with `ok` true, and the explanation.
    """

    explanation: str
    words: str = REQUEST_FAILED
    code: Code | None = None
    harmless: bool = False

    @property
    def reason(self) -> str:
        """The explanation up to the colon: what is wrong."""
        return self.explanation.partition(":")[0]


class RefusedError(Exception):
    """The robot refuses a request. The text is the explanation, with its values.

    Args:
        refusal: the situation; or just its explanation, if it has the usual words and no code.
        values: values for the template of the explanation.

    Attributes:
        refusal: the situation, always as a `Refusal`.
    """

    def __init__(self, refusal: Refusal | str, **values: object) -> None:
        self.refusal = Refusal(refusal) if isinstance(refusal, str) else refusal
        explanation = self.refusal.explanation
        # Text without values is not a template: it may contain braces that a client has sent.
        super().__init__(explanation.format(**values) if values else explanation)


# Modes and conditions

EMERGENCY_STOP = Refusal("emergency stop is pressed: release it first")
KEY_AT_MANUAL = Refusal(
    "key switch is at manual: turn it to automatic first", NOT_AUTO_MODE, codes.NOT_AUTOMATIC
)
MANUAL_MODE = Refusal(
    "robot is in manual mode: switch to automatic first", NOT_AUTO_MODE, codes.NOT_AUTOMATIC
)
MAINTENANCE_MODE = Refusal(
    "robot is in maintenance mode: switch to automatic first", NOT_AUTO_MODE, codes.NOT_AUTOMATIC
)
DEPLOYMENT_MODE = Refusal("robot is in deployment mode: switch to task mode first", NOT_TASK_MODE)
SCHEDULE_MODE = Refusal(
    "robot is in schedule mode: a dispatch system drives it; switch to task mode first"
)
NOT_INITIALISED = Refusal("robot is not initialised: send InitRobot first")
LOCALISATION_LOST = Refusal("robot has lost its localisation: send InitRobot or SetRobotPose first")
BATTERY_EMPTY = Refusal("battery is empty: charge first")

# Velocities

TWIST_IN_EMERGENCY_STOP = Refusal(
    EMERGENCY_STOP.explanation, NO_TWIST, codes.SPEED_CONTROL_FORBIDDEN
)
TWIST_IN_MAINTENANCE_MODE = Refusal(
    "robot is in maintenance mode: switch to automatic or manual first",
    NO_TWIST,
    codes.SPEED_CONTROL_FORBIDDEN,
)
TWIST_WITH_EMPTY_BATTERY = Refusal(
    BATTERY_EMPTY.explanation, NO_TWIST, codes.SPEED_CONTROL_FORBIDDEN
)
TWIST_WHILE_DRIVING = Refusal(
    "{driver} is driving: pause or cancel it first", NO_TWIST, codes.SPEED_CONTROL_FORBIDDEN
)
FOLLOW_WHILE_DRIVING = Refusal("{driver} is driving: pause or cancel it first", TASK_IS_EXECUTING)

# Tasks

TASK_RUNNING = Refusal(
    "task {task} is running: wait for it or cancel it first",
    TASK_IS_EXECUTING,
    codes.TASK_RUNNING,
)
UNKNOWN_TASK_SET = Refusal(
    "unknown task set {task_set}: RepeatTasks lists {task_sets}", code=codes.NO_SUCH_TASK_SET
)
NO_TASK = Refusal("no task is running: start one by ExecTask first")
NO_TASK_TO_PAUSE = Refusal(NO_TASK.explanation, code=codes.PAUSING_FORBIDDEN)
NO_TASK_TO_RESUME = Refusal(NO_TASK.explanation, code=codes.RESUMING_FORBIDDEN)
NOT_WAITING = Refusal("no task is waiting: there is no wait to end", code=codes.NOT_WAITING)

# Navigation

NO_NAVIGATION = Refusal(
    "no navigation is running: start a task first", code=codes.PATH_NOT_NAVIGATING
)
NAVIGATION_MODE_UNUSED = Refusal(
    "no effect: a navigation mode counts only while a task is navigating",
    code=codes.MODE_NOT_NAVIGATING,
    harmless=True,
)
NO_NAVIGATION_FOR_MODE = Refusal(
    "no navigation is running: a navigation mode counts only during a navigation",
    code=codes.MODE_NOT_NAVIGATING,
)
PATH_EMPTY = Refusal(
    "the path has no poses: give at least one pose or target", code=codes.PATH_EMPTY
)

# Actions

ACTION_DURING_TASK = Refusal(
    "task {task} is running: pause or cancel it first", TASK_IS_EXECUTING, codes.TASK_RUNNING
)
NO_STEPS = Refusal(
    "steps_size is empty: StepControl has no steps, give at least one", "steps_size is empty"
)
STEPS_DURING_TASK = Refusal(ACTION_DURING_TASK.explanation, code=codes.STEP_CONTROL_OCCUPIED)
ACTION_RUNNING = Refusal("{action} is running: wait for it or cancel it first")
STEPS_RUNNING = Refusal(ACTION_RUNNING.explanation, code=codes.STEP_CONTROL_OCCUPIED)

# Localisation and modes

INIT_DURING_TASK = Refusal(
    "task {task} is running: wait for it or cancel it first", code=codes.INITIALISATION_FORBIDDEN
)
INIT_WHILE_MAPPING = Refusal(
    "map {map} is being made: save or cancel it by BuildMap first",
    code=codes.INITIALISATION_FORBIDDEN,
)
POSE_WHILE_MAPPING = Refusal(INIT_WHILE_MAPPING.explanation)
WORK_MODE_WHILE_MAPPING = Refusal(INIT_WHILE_MAPPING.explanation, code=codes.WORK_MODE_FORBIDDEN)
POSE_OUTSIDE_MAP = Refusal("pose {pose} is outside map {map}: choose one inside")

# Maps

MAP_CHANGE_WHILE_PAUSED = Refusal(
    "task {task} is paused: cancel it first", code=codes.MAP_CHANGE_FORBIDDEN
)
MAP_CHANGE_DURING_TASK = Refusal(
    "a task is running: wait for it or cancel it first", code=codes.MAP_CHANGE_FORBIDDEN
)
MAP_CHANGE_WHILE_DRIVING = Refusal(
    "{driver} is driving: wait for it or cancel it first", code=codes.MAP_CHANGE_FORBIDDEN
)
MAP_CHANGE_WHILE_NAVIGATION_PAUSED = Refusal(
    "a navigation is paused: cancel it first", code=codes.MAP_CHANGE_FORBIDDEN
)
MAP_EXISTS = Refusal("map {map} of scene {scene} exists already: choose another name")
NO_NAME = Refusal("{field} is empty: give a name")
TOO_MANY_MAPS = Refusal("scene {scene} would have more than {limit} maps: delete one first")
MAP_CHANGE_WHILE_MAPPING = Refusal(
    "map {map} is being made: save or cancel it by BuildMap first", code=codes.MAP_CHANGE_FORBIDDEN
)
TOO_MANY_SCENES = Refusal("there are already {limit} scenes: replace one of them")

# Mapping and deployment

MAPPING_OUTSIDE_DEPLOYMENT = Refusal(
    "robot is not in deployment mode and automatic control: send SwitchWorkMode with mode 1 and "
    "SwitchControlMode with mode 1 first",
    code=codes.MAPPING_FORBIDDEN,
)
SAVE_OUTSIDE_DEPLOYMENT = Refusal(
    MAPPING_OUTSIDE_DEPLOYMENT.explanation, code=codes.SAVING_FORBIDDEN
)
# `phase` is the value of a `behaviour.mapping.Phase`, e.g. "is running".
MAPPING_RUNS = Refusal("mapping of {map} {phase}: save or cancel it first")
MAPPING_CHANGES = Refusal("mapping of {map} {phase}: wait for the answer to BuildMap first")
UPDATE_UNKNOWN_SCENE = Refusal(
    "unknown scene {scene}: use one of {scenes}", code=codes.WRONG_UPDATE_PARAMETERS
)
UPDATE_UNKNOWN_MAP = Refusal(
    "unknown map {map} of scene {scene}, which has {maps}", code=codes.WRONG_UPDATE_PARAMETERS
)
UPDATE_OTHER_MAP = Refusal(
    "map {map} of scene {scene} is not the current one: switch to it by SwitchMap first",
    code=codes.WRONG_UPDATE_PARAMETERS,
)
SAVE_WHILE_LOST = Refusal(LOCALISATION_LOST.explanation, code=codes.SAVING_WHILE_LOST)
COLLECTING_OUTSIDE_DEPLOYMENT = Refusal(
    "robot is not in deployment mode: send SwitchWorkMode with mode 1 first",
    code=codes.DEPLOYMENT_FORBIDDEN,
)

# Settings

TEXT_TOO_LONG = Refusal("{field} is longer than {limit} characters: give a shorter one")

REFUSALS = {name: value for name, value in [*globals().items()] if isinstance(value, Refusal)}
"""All situations of this module, by name."""
