"""The table of all endpoints: their ROS names and types, and the chassis messages behind them.

Servers, publishers, policies, documentation and tests derive from this table. Names are relative to
the agent's namespace. Types are given by name, so that the table can be read without ROS.
`python3 -m woosh_robot_agent.endpoints` prints it in Markdown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

NAMESPACE = "/woosh_robot"
"""Usual namespace of the agent."""


@dataclass(frozen=True)
class Query:
    """A service that requests a value from the chassis.

    Attributes:
        srv: ROS type of the service; the response has exactly one field.
        request: protobuf full name of the request and of the answer.
        field: name of the response's field.
        takes_arg: True if the request has the field `arg`; otherwise it has no fields.
        timeout: minimum timeout for the answer, in seconds; 0 if that of the parameter
            `poll_timeout` suffices.
        extra: True if the manufacturer's agent lacks it.
    """

    name: str
    srv: str
    request: str
    field: str = "info"
    takes_arg: bool = False
    timeout: float = 0.0
    extra: bool = False


@dataclass(frozen=True)
class Command:
    """A service that makes the chassis do something, or requests a value that `arg` specifies.

    Attributes:
        srv: ROS type of the service. The request has the field `arg`, the response `ok`, `msg` and
            optionally `ret`.
        request: protobuf full name of the request.
        answer: protobuf full name of the answer, which becomes `ret`; empty if there is no `ret`.
        timeout: minimum timeout for the answer, in seconds; 0 if that of the parameter
            `poll_timeout` suffices.
        reads: True if the command only reads: it changes and moves nothing.
        two_types: True if an answer may be labelled with the type of the request, although its
            content is of the type `answer`.
        extra: True if the manufacturer's agent lacks it.
    """

    name: str
    srv: str
    request: str
    answer: str = ""
    timeout: float = 0.0
    reads: bool = False
    two_types: bool = False
    extra: bool = False


@dataclass(frozen=True)
class Topic:
    """A topic on which the pushes of one type are published.

    Attributes:
        push: protobuf full name of the push; empty if the agent publishes about itself.
        depth: number of messages that late subscribers receive.
        on_demand: True if the pushes are large: the agent asks the chassis for them only while the
            topic has subscribers.
        extra: True if the manufacturer's agent lacks it.
    """

    name: str
    msg: str
    push: str
    depth: int = 1
    on_demand: bool = False
    extra: bool = False


@dataclass(frozen=True)
class Action:
    """An action that the chassis executes and reports on.

    Attributes:
        action: ROS type of the action. Its goal has the field `arg`, its result `ret`, and its
            feedback `fb`.
        arg: protobuf full name of the goal's `arg`.
        feedback: protobuf full name of the reports, which become `fb` and `ret`.
        member: member of the oneof of woosh.ros.CallAction that carries `arg`; empty if `arg`
            itself is the request.
        extra: True if the manufacturer's agent lacks it.
    """

    name: str
    action: str
    arg: str
    feedback: str
    member: str = ""
    extra: bool = False


_GROUPS = {
    "device": ("woosh_robot_msgs/", "woosh.device."),
    "map": ("woosh_map_msgs/", "woosh.map."),
    "map/storage": ("woosh_map_msgs/Storage", "woosh.map.mark.storage."),
    "robot": ("woosh_robot_msgs/", "woosh.robot."),
    "robot/count": ("woosh_robot_msgs/", "woosh.robot.count."),
    "task": ("woosh_task_msgs/", "woosh.task."),
}
"""Prefixes of ROS type and protobuf full name, by the part of an endpoint's name before the last
slash."""


def _types(name: str) -> tuple[str, str]:
    """Return ROS type and protobuf full name that follow from an endpoint's name."""
    group, _, short = name.rpartition("/")
    ros_prefix, prefix = _GROUPS[group]
    return f"{ros_prefix}{short}", f"{prefix}{short}"


def _query(name: str, *, request: str = "", **options: Any) -> Query:
    """Return a query; `request` and `options` are fields of `Query`."""
    srv, usual_request = _types(name)
    return Query(name, srv, request or usual_request, **options)


def _command(name: str, answer: str = "", **options: Any) -> Command:
    """Return a command; `options` are fields of `Command`."""
    srv, request = _types(name)
    return Command(name, srv, request, answer, **options)


def _setting(short: str, name: str = "") -> Command:
    """Return a command that changes a setting; request and answer have the same type."""
    full_name = f"woosh.robot.setting.{short}"
    return Command(name or f"setting/{short}", f"woosh_robot_msgs/Set{short}", full_name, full_name)


def _topic(short: str, depth: int = 1, package: str = "woosh.robot") -> Topic:
    """Return a topic that the manufacturer's agent has too; all of these begin with `robot/`."""
    return Topic(f"robot/{short}", f"woosh_robot_msgs/{short}", f"{package}.{short}", depth)


def _extra_topic(name: str, depth: int = 1, *, on_demand: bool = False) -> Topic:
    """Return a topic that the manufacturer's agent lacks."""
    msg, push = _types(name)
    return Topic(name, msg, push, depth, on_demand=on_demand, extra=True)


def _robot_action(short: str, member: str, *, extra: bool = False) -> Action:
    """Return an action that is started by the field `member` of woosh.ros.CallAction."""
    return Action(
        f"ros/{short}",
        f"woosh_ros_msgs/{short}",
        arg=f"woosh.ros.action.{short}",
        feedback="woosh.ros.Feedback",
        member=member,
        extra=extra,
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
    _query("map/SceneDataEasy", timeout=60.0),
    _query("task/RepeatTasks"),
    _query("task/CallTasks"),
    _query("map/SceneList", extra=True),
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
    _command("map/SceneData", "woosh.map.SceneData", timeout=60.0, reads=True, extra=True),
    _command("map/Download", "woosh.map.DownloadResponse", timeout=120.0, reads=True, extra=True),
    _command("map/Upload", timeout=120.0, extra=True),
    _command("map/Rename", extra=True),
    _command("map/Delete", extra=True),
    _command("map/SceneMd5", "woosh.map.SceneMd5Response", timeout=60.0, reads=True, extra=True),
    _command("map/SceneSync", "woosh.map.SceneSyncResponse", timeout=120.0, reads=True, extra=True),
    _command("map/storage/Create", "woosh.map.mark.Storage", extra=True),
    _command("map/storage/Update", extra=True),
    _command("map/storage/Delete", extra=True),
    _command("map/storage/Find", "woosh.map.mark.Storage", reads=True, extra=True),
    _command("map/storage/Storages", "woosh.map.mark.Storages", reads=True, extra=True),
    _command(
        "robot/PlanNavPath",
        "woosh.robot.NavPath",
        timeout=30.0,
        reads=True,
        two_types=True,
        extra=True,
    ),
    # not `reads`: all of its request types but kGet change the records
    _command("robot/CountData", "woosh.robot.CountDataResponse", extra=True),
    _command("robot/BuildMap", timeout=600.0, extra=True),
    _command("robot/Deployment", "woosh.robot.DeploymentResponse", extra=True),
    _command("robot/LED", extra=True),
    _command("robot/ExecTaskSet", extra=True),  # not implemented yet, says the manufacturer
    _command("task/RepeatTask", extra=True),
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
    _extra_topic("robot/BuildMapData", on_demand=True),
    _extra_topic("robot/ScannerData", on_demand=True),
    _extra_topic("robot/count/Operation"),
    _extra_topic("robot/count/Task", depth=10),
    _extra_topic("robot/count/Status", depth=10),
    # depth 1: a key that was pressed long ago must not seem to be pressed again
    _extra_topic("device/RfRemoteController"),
)

AGENT_INFO = Topic("robot/AgentInfo", "woosh_robot_msgs/AgentInfo", push="")
"""The topic that tells if the agent has a link to the chassis."""

ACTIONS = (
    Action(
        "robot/ExecTask",
        "woosh_robot_msgs/ExecTask",
        arg="woosh.robot.ExecTask",
        feedback="woosh.robot.TaskProc",
    ),
    _robot_action("StepControl", "step_control"),
    _robot_action("LiftControl", "lift_control"),
    _robot_action("LiftControl3", "lift_control3"),
    _robot_action("MoveBase", "move_base"),
    Action(
        "robot/ExecPreTask",
        "woosh_robot_msgs/ExecPreTask",
        arg="woosh.robot.ExecPreTask",
        feedback="woosh.robot.TaskProc",
        extra=True,
    ),
    _robot_action("ChargeControl", "charge_control", extra=True),
    _robot_action("LiftControl2", "lift_control2", extra=True),
    _robot_action("NavigationMode", "nav_mode", extra=True),
)


OWN_READS = ("woosh.ros.Feedbacks",)
"""Protobuf full names of read-only requests that the agent itself sends; they have no endpoint."""


def minimum_timeouts() -> dict[str, float]:
    """Return the minimum timeout of each slow request, in seconds, by its protobuf full name."""
    return {each.request: each.timeout for each in (*QUERIES, *COMMANDS) if each.timeout}


def markdown() -> str:
    """Return a Markdown table for each kind of endpoint."""
    reads: list[Query | Command] = [*QUERIES, *(each for each in COMMANDS if each.reads)]
    writes = [each for each in COMMANDS if not each.reads]
    topics = [_row(each, each.msg, "msg", each.push) for each in (*TOPICS, AGENT_INFO)]
    service_columns = ("Name", "ROS type", "Chassis message", "Timeout")
    return "\n\n".join(
        (
            _table("Queries", service_columns, [_service_row(each) for each in reads]),
            _table("Commands", service_columns, [_service_row(each) for each in writes]),
            _table("Topics", service_columns[:3], topics),
            _table(
                "Actions",
                service_columns[:3],
                [_row(each, each.action, "action", each.arg) for each in ACTIONS],
            ),
        )
    )


def _table(title: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [header, ("---",) * len(header), *rows]
    return f"### {title}\n\n" + "\n".join("| " + " | ".join(row) + " |" for row in lines)


def _service_row(service: Query | Command) -> tuple[str, ...]:
    timeout = f"{service.timeout:g} s" if service.timeout else ""
    return (*_row(service, service.srv, "srv", service.request), timeout)


def _row(
    endpoint: Query | Command | Topic | Action, ros_type: str, folder: str, message: str
) -> tuple[str, ...]:
    """Return an endpoint's cells: its name, its ROS type and the chassis message.

    An asterisk after the name marks an endpoint that the manufacturer's agent lacks.

    Args:
        ros_type: package and name of the ROS type, e.g. `woosh_robot_msgs/RobotInfo`.
        folder: folder of the type in its package: `msg`, `srv` or `action`.
    """
    name = f"{endpoint.name}\\*" if endpoint.extra else endpoint.name
    return (name, ros_type.replace("/", f"/{folder}/"), message)


if __name__ == "__main__":
    print(markdown())
