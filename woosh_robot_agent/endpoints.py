"""The table of all endpoints: their ROS names and types, and the chassis messages behind them.

Servers, publishers, policies, documentation and tests derive from this table. Names are relative to
the agent's namespace. Types are given by name, so that the table can be read without ROS.
`python3 -m woosh_robot_agent.endpoints` prints it in Markdown.
"""

from __future__ import annotations

from dataclasses import dataclass

NAMESPACE = "/woosh_robot"
"""Usual namespace of the agent."""


@dataclass(frozen=True)
class Query:
    """A service that requests a value from the chassis.

    Attributes:
        name: name of the service.
        srv: ROS type of the service; the response has exactly one field.
        request: protobuf full name of the request and of the answer.
        field: name of the response's field.
        takes_arg: True if the request has the field `arg`; otherwise it has no fields.
        timeout: minimum timeout of the answer, in seconds; 0 if `poll_timeout` suffices.
    """

    name: str
    srv: str
    request: str
    field: str = "info"
    takes_arg: bool = False
    timeout: float = 0.0


@dataclass(frozen=True)
class Command:
    """A service that makes the chassis do something.

    Attributes:
        name: name of the service.
        srv: ROS type of the service. The request has the field `arg`, the response `ok`, `msg` and
            optionally `ret`.
        request: protobuf full name of the request.
        answer: protobuf full name of the answer, which becomes `ret`; empty if there is no `ret`.
        timeout: minimum timeout of the answer, in seconds; 0 if `poll_timeout` suffices.
        reads: True if it only reads: it changes and moves nothing.
    """

    name: str
    srv: str
    request: str
    answer: str = ""
    timeout: float = 0.0
    reads: bool = False


@dataclass(frozen=True)
class RawRequest:
    """A request that chassis answer slowly, and that has no endpoint.

    Attributes:
        request: protobuf full name of the request.
        timeout: minimum timeout of the answer, in seconds.
    """

    request: str
    timeout: float


@dataclass(frozen=True)
class Topic:
    """A topic on which the pushes of one type are published.

    Attributes:
        name: name of the topic.
        msg: ROS type of the topic.
        push: protobuf full name of the push.
        depth: number of messages that late subscribers receive.
    """

    name: str
    msg: str
    push: str
    depth: int = 1


@dataclass(frozen=True)
class Action:
    """An action that the chassis executes and reports on.

    Attributes:
        name: name of the action.
        action: ROS type of the action; its parts have the fields `arg`, `ret` and `fb`.
        arg: protobuf full name of the goal's `arg`.
        feedback: protobuf full name of the reports, which become `fb` and `ret`.
        member: member of the oneof of woosh.ros.CallAction that carries `arg`; empty if `arg`
            itself is the request.
    """

    name: str
    action: str
    arg: str
    feedback: str
    member: str = ""


def _query(
    name: str,
    package: str = "woosh_robot_msgs",
    request: str = "",
    *,
    field: str = "info",
    takes_arg: bool = False,
    timeout: float = 0.0,
) -> Query:
    short = name.split("/")[1]
    full_name = request or f"woosh.robot.{short}"
    return Query(name, f"{package}/{short}", full_name, field, takes_arg, timeout)


def _command(name: str, answer: str = "", timeout: float = 0.0, *, reads: bool = False) -> Command:
    short = name.split("/")[1]
    request = f"woosh.robot.{short}"
    return Command(name, f"woosh_robot_msgs/{short}", request, answer, timeout, reads)


def _setting(short: str, name: str = "") -> Command:
    full_name = f"woosh.robot.setting.{short}"
    return Command(name or f"setting/{short}", f"woosh_robot_msgs/Set{short}", full_name, full_name)


def _topic(short: str, depth: int = 1, package: str = "woosh.robot") -> Topic:
    return Topic(f"robot/{short}", f"woosh_robot_msgs/{short}", f"{package}.{short}", depth)


def _call_action(short: str, member: str) -> Action:
    return Action(
        f"ros/{short}",
        f"woosh_ros_msgs/{short}",
        f"woosh.ros.action.{short}",
        "woosh.ros.Feedback",
        member,
    )


QUERIES = (
    _query("robot/RobotInfo"),
    _query("robot/General"),
    _query("robot/Setting"),
    _query("robot/RobotState"),
    _query("robot/Mode"),
    _query("robot/PoseSpeed"),
    _query("robot/Battery"),
    _query("robot/Network"),
    _query("robot/Scene"),
    _query("robot/TaskProc", takes_arg=True),
    _query("robot/TaskHistory"),
    _query("robot/DeviceState"),
    _query("robot/HardwareState"),
    _query("robot/OperationState"),
    _query("robot/Model"),
    _query("robot/AbnormalCodes", request="woosh.robot.count.AbnormalCodes"),
    _query("robot/StatusCodes", request="woosh.robot.count.StatusCodes"),
    _query("robot/NavPath", field="nav_path", timeout=30.0),
    _query("robot/PlanPath", field="plan_path", timeout=30.0),
    _query("map/SceneDataEasy", "woosh_map_msgs", "woosh.map.SceneDataEasy", timeout=60.0),
    _query("task/RepeatTasks", "woosh_task_msgs", "woosh.task.RepeatTasks"),
    _query("task/CallTasks", "woosh_task_msgs", "woosh.task.CallTasks"),
)

COMMANDS = (
    _command("robot/InitRobot", timeout=30.0),
    _command("robot/SetRobotPose"),
    _command("robot/SetOccupancy"),
    _command("robot/SetMuteCall"),
    _command("robot/SetProgramMute"),
    _command("robot/SwitchControlMode", "woosh.robot.Mode"),
    _command("robot/SwitchWorkMode", "woosh.robot.Mode", timeout=30.0),
    _command("robot/SwitchFootPrint", "woosh.robot.SwitchFootPrint"),
    _command("robot/SwitchMap", timeout=60.0),
    _command("robot/ScannerData", "woosh.robot.ScannerData", reads=True),
    _command("robot/ExecPreTask"),
    _command("robot/ExecTask"),
    _command("robot/ActionOrder"),
    _command("robot/ChangeNavPath"),
    _command("robot/ChangeNavMode"),
    _command("robot/Speak"),
    _command("robot/Twist"),
    _command("robot/Follow"),
    _command("robot/RobotWiFi", "woosh.robot.RobotWiFi"),
    _setting("Identity"),
    _setting("Identity", "setting/SetIdentity"),  # the manufacturer's manual uses both names
    _setting("Server"),
    _setting("AutoCharge"),
    _setting("AutoPark"),
    _setting("GoodsCheck"),
    _setting("Power"),
    _setting("Sound"),
)

TOPICS = (
    _topic("Setting"),
    _topic("RobotState"),
    _topic("Mode"),
    _topic("PoseSpeed"),
    _topic("Battery"),
    _topic("Network"),
    _topic("Scene"),
    _topic("TaskProc", depth=10),
    _topic("DeviceState"),
    _topic("HardwareState"),
    _topic("OperationState"),
    _topic("Model"),
    _topic("AbnormalCodes", package="woosh.robot.count"),
    _topic("StatusCode", depth=50, package="woosh.robot.count"),
    _topic("NavPath"),
)

ACTIONS = (
    Action(
        "robot/ExecTask",
        "woosh_robot_msgs/ExecTask",
        "woosh.robot.ExecTask",
        "woosh.robot.TaskProc",
    ),
    _call_action("StepControl", "step_control"),
    _call_action("LiftControl", "lift_control"),
    _call_action("LiftControl3", "lift_control3"),
    _call_action("MoveBase", "move_base"),
)

RAW_REQUESTS = (
    RawRequest("woosh.robot.BuildMap", 600.0),
    RawRequest("woosh.robot.PlanNavPath", 30.0),
    RawRequest("woosh.map.SceneData", 60.0),
    RawRequest("woosh.map.Download", 120.0),
    RawRequest("woosh.map.Upload", 120.0),
)


def minimum_timeouts() -> dict[str, float]:
    """Return the minimum timeout of each slow request, in seconds, by its protobuf full name."""
    requests = (*QUERIES, *COMMANDS, *RAW_REQUESTS)
    return {each.request: each.timeout for each in requests if each.timeout}


OWN_READS = ("woosh.map.SceneData", "woosh.ros.Feedbacks")
"""Protobuf full names of requests that have no endpoint, and with which the agent only reads."""


def markdown() -> str:
    """Return the whole table in Markdown."""
    rows: list[tuple[str, ...]] = [
        ("Kind", "Name", "ROS type", "Chassis message", "Timeout"),
        ("---",) * 5,
    ]
    rows += [_row("query", e.name, e.srv, "srv", e.request, e.timeout) for e in QUERIES]
    rows += [_row("command", e.name, e.srv, "srv", e.request, e.timeout) for e in COMMANDS]
    rows += [_row("topic", e.name, e.msg, "msg", e.push) for e in TOPICS]
    rows += [_row("action", e.name, e.action, "action", e.arg) for e in ACTIONS]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def raw_requests_markdown() -> str:
    """Return the requests without an endpoint and their minimum timeouts in Markdown."""
    rows = ["| Request | Timeout |", "| --- | --- |"]
    rows += [f"| {each.request} | {each.timeout:g} s |" for each in RAW_REQUESTS]
    return "\n".join(rows)


def _row(
    kind: str, name: str, ros: str, folder: str, message: str, timeout: float = 0.0
) -> tuple[str, ...]:
    return kind, name, ros.replace("/", f"/{folder}/"), message, f"{timeout:g} s" * bool(timeout)


if __name__ == "__main__":
    print(markdown())
