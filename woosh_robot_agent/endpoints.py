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
    """

    name: str
    srv: str
    request: str
    field: str = "info"
    takes_arg: bool = False


@dataclass(frozen=True)
class Command:
    """A service that makes the chassis do something.

    Attributes:
        name: name of the service.
        srv: ROS type of the service. The request has the field `arg`, the response `ok`, `msg` and
            optionally `ret`.
        request: protobuf full name of the request.
        answer: protobuf full name of the answer, which becomes `ret`; empty if there is no `ret`.
    """

    name: str
    srv: str
    request: str
    answer: str = ""


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
    field: str = "info",
    takes_arg: bool = False,
) -> Query:
    short = name.split("/")[1]
    return Query(name, f"{package}/{short}", request or f"woosh.robot.{short}", field, takes_arg)


def _command(name: str, answer: str = "") -> Command:
    short = name.split("/")[1]
    return Command(name, f"woosh_robot_msgs/{short}", f"woosh.robot.{short}", answer)


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
    _query("robot/NavPath", field="nav_path"),
    _query("robot/PlanPath", field="plan_path"),
    _query("map/SceneDataEasy", "woosh_map_msgs", "woosh.map.SceneDataEasy"),
    _query("task/RepeatTasks", "woosh_task_msgs", "woosh.task.RepeatTasks"),
    _query("task/CallTasks", "woosh_task_msgs", "woosh.task.CallTasks"),
)

COMMANDS = (
    _command("robot/InitRobot"),
    _command("robot/SetRobotPose"),
    _command("robot/SetOccupancy"),
    _command("robot/SetMuteCall"),
    _command("robot/SetProgramMute"),
    _command("robot/SwitchControlMode", "woosh.robot.Mode"),
    _command("robot/SwitchWorkMode", "woosh.robot.Mode"),
    _command("robot/SwitchFootPrint", "woosh.robot.SwitchFootPrint"),
    _command("robot/SwitchMap"),
    _command("robot/ScannerData", "woosh.robot.ScannerData"),
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


def markdown() -> str:
    """Return the whole table in Markdown."""
    rows = [("Kind", "Name", "ROS type", "Chassis message"), ("---",) * 4]
    rows += [("query", e.name, e.srv.replace("/", "/srv/"), e.request) for e in QUERIES]
    rows += [("command", e.name, e.srv.replace("/", "/srv/"), e.request) for e in COMMANDS]
    rows += [("topic", e.name, e.msg.replace("/", "/msg/"), e.push) for e in TOPICS]
    rows += [("action", e.name, e.action.replace("/", "/action/"), e.arg) for e in ACTIONS]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


if __name__ == "__main__":
    print(markdown())
