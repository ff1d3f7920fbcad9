"""Every situation in which the simulated robot refuses a request.

Each is declared once, with three things: an explanation for people, the words of the real robot,
and the status code by which the real robot gives its reason. The profile decides which are sent.
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
        explanation: What is wrong, then after a colon what to do: a template for `str.format`.
        words: Text of the real robot's answer; None for a limit that only the simulator has, which
            is always explained.
        code: Status code that follows the answer of the real robot; None if there is none.
        harmless: Only the real robot refuses. Where refusals are explained, the answer is `ok`,
            with the explanation.
    """

    explanation: str
    words: str | None = REQUEST_FAILED
    code: Code | None = None
    harmless: bool = False

    @property
    def reason(self) -> str:
        """The explanation without what to do."""
        return self.explanation.partition(":")[0]


class RefusedError(Exception):
    """The robot refuses a request. The text is the explanation.

    Args:
        refusal: The situation.
        values: Values for the template of the explanation.

    Attributes:
        refusal: The situation.
    """

    def __init__(self, refusal: Refusal, **values: object) -> None:
        super().__init__(refusal.explanation.format(**values))
        self.refusal = refusal


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
TWIST_SIDEWAYS = Refusal("a differential base cannot move sideways: linear_y must be 0")
FOLLOW_WHILE_DRIVING = Refusal("{driver} is driving: pause or cancel it first", TASK_IS_EXECUTING)

# Tasks

TASK_RUNNING = Refusal(
    "task {task} is running: wait for it or cancel it first",
    TASK_IS_EXECUTING,
    codes.TASK_RUNNING,
)
NO_TARGET = Refusal("the task has no target: give mark_no, plan_path or pose")
UNKNOWN_MARK = Refusal("unknown mark {mark} in map {map}: its marks are {marks}")
NOT_A_CHARGER = Refusal("mark {mark} is not a charger: choose one that is")
UNKNOWN_TASK_SET = Refusal(
    "unknown task set {task_set}: RepeatTasks lists {task_sets}", code=codes.NO_SUCH_TASK_SET
)
NO_TASK_SET = Refusal(
    "ExecTaskSet names no task set, and real chassis do not implement it: send ExecPreTask, or "
    "RepeatTask with order 3"
)
UNKNOWN_REPEAT_ORDER = Refusal("unknown order {order}: 1 is put, 2 delete, 3 execute")
TASK_SET_ID_INVALID = Refusal("task set id {task_set} is negative: give a positive one, or 0")
TASK_SET_SIZE = Refusal("the task set has {count} tasks: give 1 to {limit}")
TASK_SET_TOO_LARGE = Refusal("the task set has more than {limit} bytes: give a smaller one")
TASK_IDS_INVALID = Refusal("task ids {ids} must be different numbers from 1 to {limit}, or all 0")
TOO_MANY_TASK_SETS = Refusal("there are already {limit} task sets: delete one of them first")
TIMES_OUT_OF_RANGE = Refusal("{times} repetitions are not within 0 to {limit}")
UNKNOWN_MARK_OF_SCENE = Refusal("unknown mark {mark}: no map of scene {scene} has it")
NO_TASK = Refusal("no task is running: start one by ExecTask first")
NO_TASK_TO_PAUSE = Refusal(NO_TASK.explanation, code=codes.PAUSING_FORBIDDEN)
NO_TASK_TO_RESUME = Refusal(NO_TASK.explanation, code=codes.RESUMING_FORBIDDEN)
NOT_WAITING = Refusal("no task is waiting: there is no wait to end", code=codes.NOT_WAITING)
START_ORDER = Refusal("order 1 (start) is not supported: a task starts by itself")
UNKNOWN_ORDER = Refusal("unknown order {order}: 2 is pause, 3 continue, 4 cancel, 5 recover")

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
    "no navigation is running: a navigation mode counts only while one is",
    code=codes.MODE_NOT_NAVIGATING,
)
NO_PATH = Refusal("{failure}")
PATH_EMPTY = Refusal(
    "the path has no poses: give at least one pose or target", code=codes.PATH_EMPTY
)
NO_END = Refusal("PlanNavPath has no end: give the pose to plan a path to")
NEGATIVE_TOLERANCE = Refusal("tolerance {tolerance:g} is negative: use 0 for any detour")
DETOUR_TOO_LONG = Refusal(
    "the path has a detour of {detour:.2f} m, more than the tolerance of {limit:g} m: raise it"
)
PATH_TOO_LONG = Refusal("the path has more than {limit} poses: send fewer")
TOO_MANY_POSES = Refusal("{count} poses are more than {limit}: send fewer")
NEGATIVE_SPEED = Refusal("max_speed {speed:g} is negative: use 0 for the default")
SPEED_TOO_LOW = Refusal("speed {speed:g} is too slow: use at least {limit:g}, or 0 for the default")
UNKNOWN_NAVIGATION_MODE = Refusal("unknown navigation mode {mode}: use one of {modes}")

# Actions

ACTION_DURING_TASK = Refusal(
    "task {task} is running: pause or cancel it first", TASK_IS_EXECUTING, codes.TASK_RUNNING
)
STEPS_DURING_TASK = Refusal(ACTION_DURING_TASK.explanation, code=codes.STEP_CONTROL_OCCUPIED)
ACTION_RUNNING = Refusal("{action} is running: wait for it or cancel it first")
STEPS_RUNNING = Refusal(ACTION_RUNNING.explanation, code=codes.STEP_CONTROL_OCCUPIED)
ACTION_NOT_RUNNING = Refusal("{action} is not running: execute it first")
NO_ACTION = Refusal("CallAction names no action: set one of its fields")
UNKNOWN_ACTION = Refusal("unknown action {action}: this chassis has {actions}")
UNKNOWN_CONTROL = Refusal(
    "unknown control action {control}: 0 is cancel, 1 execute, 2 pause, 3 resume"
)
NO_STEPS = Refusal("StepControl has no steps: give at least one")
TOO_MANY_STEPS = Refusal(
    "StepControl has {count} steps, more than {limit}: split it into several requests"
)
UNKNOWN_STEP_MODE = Refusal(
    "unknown step mode {mode}: 1 is straight, 2 rotate, 3 lateral, 4 diagonal"
)
STEP_SIDEWAYS = Refusal(
    "a differential base cannot move sideways: use step modes 1 (straight) and 2 (rotate)"
)
UNKNOWN_LIFT_MODE = Refusal("unknown lift mode {mode}: 1 is up, 2 is down")
UNKNOWN_LIFT3_MODE = Refusal(
    "unknown lift mode {mode}: 0 is query, 1 absolute, 2 relative, 3 calibration"
)
LIFT_OUT_OF_RANGE = Refusal("{lift}: {height:.3f} m is not within 0 to {limit:g} m")
NOT_AT_CHARGER = Refusal("robot is not at a charger: start a charge task instead")
UNKNOWN_CHARGE_MODE = Refusal("unknown charge mode {mode}: 1 is automatic, 2 is exit")
NO_GOAL = Refusal("MoveBase has no target: give target_pose or poses")

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
POSE_IN_WALL = Refusal("pose {pose} is inside a wall of map {map}: choose one on free floor")
UNKNOWN_CONTROL_MODE = Refusal(
    "unknown control mode {mode}: 1 is automatic, 2 manual, 3 maintenance"
)
UNKNOWN_WORK_MODE = Refusal("unknown work mode {mode}: 1 is deployment, 2 task, 3 schedule")
UNKNOWN_FOOTPRINT = Refusal("unknown footprint {footprint}: use one of {footprints}")

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
SCENE_EXISTS = Refusal("scene {scene} exists already: choose another name")
MAP_EXISTS = Refusal("map {map} of scene {scene} exists already: choose another name")
CURRENT_SCENE = Refusal("the robot is in scene {scene}: switch to another one first")
CURRENT_MAP = Refusal("the robot is on map {map}: switch to another one first")
CURRENT_MAP_MISSING = Refusal(
    "the upload has no map {map}, which the robot is on: add it, or switch to another scene first"
)
LAST_MAP = Refusal("map {map} is the only one of scene {scene}: delete the scene instead")
NO_NAME = Refusal("{field} is empty: give a name")
NAME_INVALID = Refusal(
    "{field} {name!r} must be a name of at most {limit} characters that is not a path"
)
NO_FILES = Refusal("the upload has no files: give at least one")
NO_MAP_IN_UPLOAD = Refusal(
    "no file describes a map of scene {scene}: add scene.yaml, or the YAML file and the picture of "
    "a map of map_server"
)
UNKNOWN_FILE = Refusal("unknown file {file} of scene {scene}: SceneMd5 lists its files")
TOO_MANY_MAPS = Refusal("scene {scene} would have more than {limit} maps: delete one first")
MAP_CHANGE_WHILE_MAPPING = Refusal(
    "map {map} is being made: save or cancel it by BuildMap first", code=codes.MAP_CHANGE_FORBIDDEN
)
UNKNOWN_SCENE = Refusal(
    "unknown scene {scene}: use one of {scenes}, or upload it by SwitchMap with file_datas"
)
UNKNOWN_MAP = Refusal("unknown map {map} of scene {scene}, which has {maps}")
TOO_MANY_SCENES = Refusal("there are already {limit} scenes: replace one of them")
SCENE_INVALID = Refusal("scene {scene} is not changed: {error}")
FILE_NAME_INVALID = Refusal(
    "file {file!r}: the name must be a plain file name of at most {limit} characters"
)
FILE_INVALID = Refusal("{error}")
FILE_TWICE = Refusal("file {file} is uploaded twice")
SCENE_TOO_LARGE = Refusal(
    "{count} files of {size} bytes are more than the limit of a scene: {max_count} files, "
    "{max_size} bytes"
)

# Marks

NO_MARK_NUMBER = Refusal("the mark has no number: set identity.no")
MARK_EXISTS = Refusal(
    "mark {mark} of map {map} exists already: choose another number, or update it"
)
MARK_ID_EXISTS = Refusal("mark {mark} of map {map} has the id {id} already: use 0 for a free one")
MARK_WITHOUT_POSE = Refusal("mark {mark} has no pose: set pose.dock")
MARK_OUTSIDE_MAP = Refusal("mark {mark} is outside map {map}: choose a pose inside")
MARK_TOO_LARGE = Refusal("the data of mark {mark} have {size} bytes, more than {limit}: send fewer")
TOO_MANY_MARKS = Refusal("map {map} has {limit} marks already: delete one first")

# Mapping and deployment

MAPPING_OUTSIDE_DEPLOYMENT = Refusal(
    "robot is not in deployment mode and automatic control: send SwitchWorkMode with mode 1 and "
    "SwitchControlMode with mode 1 first",
    code=codes.MAPPING_FORBIDDEN,
)
SAVE_OUTSIDE_DEPLOYMENT = Refusal(
    MAPPING_OUTSIDE_DEPLOYMENT.explanation, code=codes.SAVING_FORBIDDEN
)
MAPPING_RUNS = Refusal("mapping of {map} {phase}: save or cancel it first")
MAPPING_CHANGES = Refusal("mapping of {map} {phase}: wait for the answer first")
NOT_MAPPING = Refusal("no map is being made: send BuildMap with type 1 (add) or 2 (update) first")
UPDATE_UNKNOWN_SCENE = Refusal(
    "unknown scene {scene}: use one of {scenes}", code=codes.UPDATE_PARAMETERS
)
UPDATE_UNKNOWN_MAP = Refusal(
    "unknown map {map} of scene {scene}, which has {maps}", code=codes.UPDATE_PARAMETERS
)
UPDATE_OTHER_MAP = Refusal(
    "map {map} of scene {scene} is not the current one: switch to it by SwitchMap first",
    code=codes.UPDATE_PARAMETERS,
)
SAVE_WHILE_LOST = Refusal(LOCALISATION_LOST.explanation, code=codes.SAVING_LOST)
UNKNOWN_BUILD_TYPE = Refusal(
    "unknown type {type} of BuildMap: 1 is add, 2 update, 3 cancel, 4 save"
)
COLLECTING_OUTSIDE_DEPLOYMENT = Refusal(
    "robot is not in deployment mode: send SwitchWorkMode with mode 1 first",
    code=codes.DEPLOYMENT_FORBIDDEN,
)
OTHER_ROBOT = Refusal("the request is for robot {robot_id}: this is robot {own_id}")
UNKNOWN_DEPLOYMENT_TYPE = Refusal(
    "unknown type {type} of Deployment: 1 is beacons, 2 codes, 3 reflectors, 4 marks"
)
UNKNOWN_DEPLOYMENT_MODE = Refusal(
    "unknown mode {mode} of Deployment: 1 is collect, 2 cancel, 3 calibrate"
)
ONLY_REFLECTORS = Refusal("only reflectors can be calibrated: use type 3")
NO_REFLECTORS = Refusal("map {map} has no reflectors: collect them first")

# Settings

TEXT_TOO_LONG = Refusal("{field} is longer than {limit} characters: give a shorter one")
PORT_OUT_OF_RANGE = Refusal("port {port} is not within 0 to 65535")
POWER_LEVELS_INVALID = Refusal(
    "power levels {levels} must rise from alarm to full, which must be at most 100"
)
VOLUME_OUT_OF_RANGE = Refusal("volume {volume} is not within 0 to 100")

UNKNOWN_LIGHT = Refusal("unknown submodule {submodule} of the lights: use 0 to {limit}")

# Statistics

UNKNOWN_COUNT_REQUEST = Refusal("unknown request type {type}: 0 is get, 1 synchronise")
UNKNOWN_COUNT_TYPE = Refusal(
    "unknown kind of statistics {type}: 0 is all, 1 operation, 2 task, 3 status"
)
NEGATIVE_PAGE = Refusal("page {page} is negative: count pages from 0")
TIME_SPAN_REVERSED = Refusal("the time span from {start} to {end} ends before it starts")

# Wi-Fi

NETWORK_NOT_KNOWN = Refusal("network {ssid} is not known: add it first")
NETWORK_OUT_OF_REACH = Refusal("network {ssid} is out of reach: choose one of the last scan")
NO_SSID = Refusal("content is not a JSON object with an ssid")
UNKNOWN_WIFI_ORDER = Refusal(
    "unknown Wi-Fi order {order}: 1 is list, 2 add, 3 reconnect, 4 forget, 5 hotspot"
)

# Requests that cannot be executed

NOT_FINITE = Refusal("{field} is not a finite number")
NO_TYPE = Refusal("the request has no type", words=None)
UNKNOWN_TYPE = Refusal("unknown message type {type}", words=None)
UNREADABLE_BODY = Refusal("unreadable body: {error}", words=None)
TOO_MANY_REQUESTS = Refusal(
    "{limit} requests of this connection are waiting: wait for their answers first", words=None
)
INTERNAL_ERROR = Refusal("internal error of the simulator: see its log", words=None)

REFUSALS = {name: value for name, value in vars().copy().items() if isinstance(value, Refusal)}
"""All situations, by name."""


def markdown() -> str:
    """Return the refusals with words or a code of their own as a Markdown table."""
    rows = ["| Situation | Words of the real robot | Status code |", "| --- | --- | --- |"]
    for name, each in REFUSALS.items():
        if each.words is None or (each.words == REQUEST_FAILED and each.code is None):
            continue
        code = f"{each.code.number}: {each.code.text('en')}" if each.code else ""
        rows.append(f"| {name.lower().replace('_', ' ')} | {each.words} | {code} |")
    return "\n".join(rows)
