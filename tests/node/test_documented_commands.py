"""Every command of the vendor's manual does what the manual says, in the manual's order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.harness import Client, wait_until
from tests.node.goals import hurry
from tests.ros2_commands import Command, documented, parse
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_msgs.msg import DeviceStateSoftwareBit as Software
from woosh_robot_msgs.msg import PoseSpeed
from woosh_robot_msgs.srv import RobotInfo

SUCCEEDED = 4
PAUSED, COMPLETED = 4, 7
FOLLOWING = 7

PAGE = Path(__file__).parents[2] / "docs" / "documented_commands.md"
REFUSED = (46, 63)
"""Lines that the robot refuses while the task of line 45 runs."""
CANCEL = (
    "ros2 service call /woosh_robot/robot/ActionOrder woosh_robot_msgs/srv/ActionOrder "
    '"{arg:{order:{value: 4}}}"'
)
"""The command by which the page lets them work."""


class Robot:
    """State of the robot, read through ROS and from the simulator."""

    def __init__(self, client: Client, simulator: SimulatorThread) -> None:
        self.client = client
        self.simulator = simulator
        self.poses = client.echo(PoseSpeed, "robot/PoseSpeed")

    @property
    def info(self) -> Any:
        return self.client.call(RobotInfo, "robot/RobotInfo").info

    def software(self, bit: int) -> bool:
        return bool(self.info.device_state.software & bit)

    def stands_at(self, pose: Any) -> bool:
        here = self.info.pose_speed.pose
        wanted = pytest.approx((pose.x, pose.y, pose.theta), abs=0.01)
        return bool((here.x, here.y, here.theta) == wanted)


def init_robot(robot: Robot, arg: Any) -> bool:
    return robot.info.state.value == 2 and (arg.is_record or robot.stands_at(arg.pose))


def change_nav_path(robot: Robot, arg: Any) -> bool:
    # the robot is paused, so it plans and publishes the new path only after a resume
    stops = robot.simulator.call(lambda inner: list(inner.chassis.ownership.navigation._stops))
    wanted = [xy for pose in arg.paths.plan_path[0].path.poses for xy in (pose.x, pose.y)]
    found = [xy for stop in stops for xy in (stop.x, stop.y)]
    return found[: len(wanted)] == pytest.approx(wanted)


def twist(robot: Robot, arg: Any) -> bool:
    # the robot accelerates, and slows down when no further command comes
    twists = [pose.twist for pose in list(robot.poses.messages)]
    return any(
        0 < now.linear <= arg.linear + 1e-6 and 0 < now.angular <= arg.angular + 1e-6
        for now in twists
    )


EFFECTS: dict[str, Callable[[Robot, Any], Any]] = {
    "robot/InitRobot": init_robot,
    "robot/SetRobotPose": lambda robot, arg: robot.stands_at(arg.pose),
    "robot/SetOccupancy": lambda robot, arg: robot.software(Software.K_OCCUPANCY) == arg.occupy,
    "robot/SetMuteCall": lambda robot, arg: robot.software(Software.K_MUTE_CALL) == arg.mute,
    "robot/SetProgramMute": lambda robot, arg: robot.software(Software.K_PROGRAM_MUTE) == arg.mute,
    "robot/SwitchControlMode": lambda robot, arg: robot.info.mode.ctrl == arg.mode,
    "robot/SwitchWorkMode": lambda robot, arg: robot.info.mode.work == arg.mode,
    "robot/SwitchFootPrint": lambda robot, arg: robot.info.model.type == arg.type,
    "robot/SwitchMap": lambda robot, arg: robot.info.scene.scene_name == arg.scene_name,
    "robot/ExecPreTask": lambda robot, arg: (
        robot.info.task_proc.robot_task_id // 100 == arg.task_set_id
    ),
    "robot/ExecTask": lambda robot, arg: robot.info.task_proc.dest == arg.mark_no,
    "robot/ActionOrder": lambda robot, arg: robot.info.task_proc.state.value == PAUSED,
    "robot/ChangeNavPath": change_nav_path,
    "robot/Speak": lambda robot, arg: robot.simulator.state.spoken[-1] == arg.text,
    "robot/Twist": twist,
    "robot/Follow": lambda robot, arg: robot.info.state.value == FOLLOWING,
    "setting/Identity": lambda robot, arg: robot.info.setting.identity.name == arg.name,
    "setting/Server": lambda robot, arg: robot.info.setting.server == arg,
    "setting/AutoCharge": lambda robot, arg: robot.info.setting.allow.auto_charge == arg.allow,
    "setting/AutoPark": lambda robot, arg: robot.info.setting.allow.auto_park == arg.allow,
    "setting/GoodsCheck": lambda robot, arg: robot.info.setting.allow.goods_check == arg.allow,
    "setting/Power": lambda robot, arg: robot.info.setting.power == arg,
    "setting/Sound": lambda robot, arg: robot.info.setting.sound == arg,
}
"""Condition that becomes true soon after a command, by the command's name."""


ANSWERS: dict[str, Callable[[Any, Any], Any]] = {
    "robot/SwitchControlMode": lambda arg, answer: answer.ret.ctrl == arg.mode,
    "robot/SwitchWorkMode": lambda arg, answer: answer.ret.work == arg.mode,
    "robot/SwitchFootPrint": lambda arg, answer: answer.ret.type == arg.type,
    "robot/ScannerData": lambda arg, answer: len(answer.ret.ranges) > 100,
    "robot/ChangeNavMode": lambda arg, answer: "no effect" not in answer.msg,
    "setting/Identity": lambda arg, answer: answer.ret.name == arg.name,
    "setting/Server": lambda arg, answer: answer.ret.ip == arg.ip,
    "setting/Power": lambda arg, answer: answer.ret.full == arg.full,
    "setting/Sound": lambda arg, answer: answer.ret.volume == arg.volume,
    "robot/RobotInfo": lambda arg, answer: answer.info.genral.serial_number == 30001,
    "robot/General": lambda arg, answer: answer.info.serial_number == 30001,
    "robot/HardwareState": lambda arg, answer: len(answer.info.motor) == 2,
    "robot/Model": lambda arg, answer: len(answer.info.model) >= 4,
    "map/SceneDataEasy": lambda arg, answer: answer.info.name == "scenex",
    "task/RepeatTasks": lambda arg, answer: answer.info.repeat_tasks,
    "task/CallTasks": lambda arg, answer: answer.info.call_tasks,
}
"""Condition that the response of a command or query must meet, by its name."""


@pytest.fixture
def simulator() -> Any:
    """A chassis as the simulator has it by default: it refuses a task while another one runs."""
    with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=2.0, seed=1)) as running:
        yield running


def refusal(client: Client, command: Command) -> str:
    """Run a command, and return why it is refused; empty if it is not."""
    filled = command.filled()
    if command.verb == "service call":
        answer = client.call(command.cls, command.name, arg=filled.arg)
        return "" if answer.ok else str(answer.msg)
    status, ret = client.send_goal(command.cls, command.name, filled).result()
    return "" if status == SUCCEEDED else str(ret.msg)


def echo(client: Client, name: str) -> Any:
    """Subscribe as `ros2 topic echo` does: with the type found in the graph."""
    types = wait_until(lambda: dict(client.node.get_topic_names_and_types()).get(client.path(name)))
    package, _, short = types[0].split("/")
    return client.echo(class_of(f"{package}/{short}", "msg"), name)


def call(robot: Robot, command: Command) -> None:
    request = command.filled()
    arg = getattr(request, "arg", None)
    fields = {} if arg is None else {"arg": arg}
    answer = robot.client.call(command.cls, command.name, **fields)
    assert getattr(answer, "ok", True), f"{command.line}: {answer.msg}"
    assert ANSWERS.get(command.name, lambda arg, answer: True)(arg, answer), command.line
    effect = EFFECTS.get(command.name, lambda robot, arg: True)
    wait_until(lambda: effect(robot, arg), f"the effect of {command.line}")


def run(robot: Robot, command: Command) -> None:
    before = robot.simulator.state
    goal = robot.client.send_goal(command.cls, command.name, command.filled())
    status, ret = goal.result(30.0)
    assert status == SUCCEEDED, f"{command.line}: {ret}"
    assert goal.feedback.messages, command.line
    after, arg = robot.simulator.state, command.filled().arg
    if command.name == "robot/ExecTask":
        assert (ret.state.value, ret.dest) == (COMPLETED, arg.mark_no)
    elif command.name == "ros/StepControl" and arg.steps[0].mode.value == 1:
        assert after.odometer - before.odometer == pytest.approx(arg.steps[0].value, abs=0.01)
    elif command.name == "ros/StepControl":
        assert after.odometer == pytest.approx(before.odometer, abs=0.01)
        assert abs(after.pose.theta - before.pose.theta) == pytest.approx(3.14, abs=0.01)
    elif command.name == "ros/LiftControl":
        up = arg.execute_mode.value == arg.execute_mode.K_UP
        assert (after.jack > before.jack) is up
    elif command.name == "ros/LiftControl3":
        start = before.column if arg.execute_mode.value == arg.execute_mode.K_RELATIVE else 0.0
        assert after.column == pytest.approx(start + arg.height, abs=0.01)
    else:
        assert robot.stands_at(arg.target_pose)


def test_documented_commands_work_in_the_documented_order(simulator, agent, client):
    """Two of them only after the task of an earlier line, as the page says."""
    robot = Robot(client, simulator)
    commands = dict(enumerate(documented(), start=1))
    echoes = {}
    for number, command in commands.items():
        if command.verb == "topic echo":
            echoes[command.name] = echo(client, command.name)
        elif number in REFUSED:
            assert "Task is excuting" in refusal(client, command), command.line
        elif command.verb == "service call":
            call(robot, command)
        else:
            hurry(simulator)
            run(robot, command)
    page = PAGE.read_text()
    assert "lines 46 and 63" in page
    assert CANCEL in page
    for number, perform in zip(REFUSED, (call, run), strict=True):
        assert refusal(client, parse(CANCEL)) == ""
        wait_until(lambda: not robot.info.task_proc.robot_task_id, "the end of the task")
        perform(robot, commands[number])
    for name, seen in echoes.items():
        assert seen.wait_count(1), name
    settings = echoes["robot/Setting"].wait(lambda m: m.sound.volume == 50 and m.power.full == 100)
    assert settings.identity.name == "woow"
    assert echoes["robot/Scene"].wait(lambda m: m.scene_name == "scenex")
    assert echoes["robot/TaskProc"].wait(lambda m: m.dest == "A2" and m.state.value == COMPLETED)
    assert echoes["robot/NavPath"].wait(lambda m: m.path.poses)
    assert echoes["robot/PoseSpeed"].wait(lambda m: m.twist.linear > 0)
    assert echoes["robot/OperationState"].wait(lambda m: m.robot & 1)
    assert echoes["robot/DeviceState"].wait(lambda m: m.software & Software.K_MUTE_CALL)
