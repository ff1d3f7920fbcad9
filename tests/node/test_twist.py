"""Velocity commands through robot/Twist: the newest wins, and a stale one is never sent."""

from __future__ import annotations

from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from tests.harness import Client, Logs, Robot, wait_future, wait_until
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import DeviceState
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import Twist

TWIST = "woosh.robot.Twist"
ROBOT_INFO = "woosh.robot.RobotInfo"


def drive(client: Client, linear: float) -> Any:
    """Command a velocity; return the future of the answer."""
    return client.call_async(Twist, "robot/Twist", arg=TwistMsg(linear=linear))


def answers(futures: list[Any]) -> list[Any]:
    return [wait_future(future) for future in futures]


def speeds(simulator: SimulatorThread) -> list[float]:
    """Return the linear velocities that the chassis has received."""
    twists = [each.message for each in simulator.received if each.type == TWIST]
    return [round(twist.linear, 4) for twist in twists]


def set_parameters(robot: Robot, **values: Any) -> None:
    parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    results = robot.call(SetParameters, "agent/set_parameters", parameters=parameters).results
    assert all(result.successful for result in results)


def test_the_last_velocity_is_not_repeated(shared_robot: Robot) -> None:
    robot = shared_robot
    before = robot.chassis.state.odometer
    answers([drive(robot, 0.4)])
    wait_until(lambda: robot.chassis.state.odometer > before)
    wait_until(lambda: robot.chassis.state.velocity.forward == 0)
    assert speeds(robot.chassis) == [0.4]


def test_a_velocity_that_no_robot_reaches_is_not_sent(shared_robot: Robot) -> None:
    robot = shared_robot
    for field, value in (("linear", 3e38), ("linear_y", -10.5), ("angular", 3e38)):
        answer = robot.call(Twist, "robot/Twist", arg=TwistMsg(**{field: value}))
        assert not answer.ok
        assert f"arg.{field} is {value:g}" in answer.msg
        assert "nothing was sent" in answer.msg
    # the agent that the tests share may have sent a zero for the drive of an earlier one
    assert not any(speeds(robot.chassis))


def test_the_limits_of_cmd_vel_hold_for_calls(robot: Robot) -> None:
    def sent(**velocity: float) -> tuple[Any, ...]:
        answer = robot.call(Twist, "robot/Twist", arg=TwistMsg(**velocity))
        assert answer.ok
        twist = robot.chassis.last(TWIST)
        return *(round(v, 4) for v in (twist.linear, twist.linear_y, twist.angular)), answer.msg

    *legal, usual = sent(linear=1.0, angular=-1.0)
    assert legal == [1.0, 0.0, -1.0]
    assert "cmd_vel_max" not in usual
    *fast, told = sent(linear=-3.0, angular=5.0)
    assert fast == [-1.0, 0.0, 1.0]
    assert told.startswith(usual)
    assert "cmd_vel_max_linear" in told
    assert sent(linear=3.0, linear_y=4.0)[:3] == (0.6, 0.8, 0.0), "the direction stays"
    set_parameters(robot, cmd_vel_max_linear=0.3, cmd_vel_max_angular=0.2)
    assert sent(linear=0.3, angular=0.2) == (0.3, 0.0, 0.2, usual)
    assert sent(linear=1.0, angular=-1.0)[:3] == (0.3, 0.0, -0.2)


def test_velocity_without_a_link_is_refused_and_not_kept(shared_robot: Robot) -> None:
    robot = shared_robot
    robot.chassis.stop_listening()
    wait_until(lambda: robot.chassis.connections == 0)
    (answer,) = answers([drive(robot, 0.4)])
    assert not answer.ok
    assert "not connected" in answer.msg or "link" in answer.msg
    robot.chassis.listen()
    robot.chassis.wait_received(ROBOT_INFO, 2)
    wait_until(lambda: robot.call(Twist, "robot/Twist").ok)
    assert set(speeds(robot.chassis)) == {0.0}


@pytest.mark.parametrize("what", ["stop", "emergency stop", "control mode", "observe_only"])
def test_calls_that_go_on_after_an_interruption_move_nothing(robot: Robot, what: str) -> None:
    """They have to begin anew; so the release of the emergency stop moves nothing."""
    robot.set_motion_timing(hold=0.0, pause=3600.0)
    states = robot.echo(DeviceState, "robot/DeviceState")
    assert wait_future(drive(robot, 0.1)).ok
    if what == "stop":
        assert robot.call(Trigger, "stop").success
        reason = "the robot was stopped"
    elif what == "control mode":
        assert robot.command("robot/SwitchControlMode", mode=2).ok
        reason = "the control mode of the robot has changed"
    elif what == "observe_only":
        set_parameters(robot, observe_only=True)
        assert "this agent only observes" in wait_future(drive(robot, 0.2)).msg
        set_parameters(robot, observe_only=False)
        reason = "velocities were not permitted until now"
    else:
        reason = "then release the button"
        robot.chassis.set_emergency_stop(True)
        states.wait(lambda state: state.hardware)
        (_zero, pressed) = answers([drive(robot, 0.0), drive(robot, 0.2)])
        assert reason in pressed.msg
        states.messages.clear()
        robot.chassis.set_emergency_stop(False)
        states.wait(lambda state: not state.hardware)
    answer = wait_future(drive(robot, 0.2))
    assert not answer.ok
    assert reason in answer.msg
    assert "send a zero velocity, or nothing for 3600 s" in answer.msg
    assert 0.2 not in speeds(robot.chassis)
    assert wait_future(drive(robot, 0.0)).ok
    # the gate refuses motion for a moment after `observe_only` was turned on
    wait_until(lambda: wait_future(drive(robot, 0.2)).ok)


@pytest.mark.parametrize("linked", [False, True], ids=["without a link", "zero refused"])
def test_the_end_of_the_agent_while_the_robot_cannot_be_stopped_is_an_error(
    robot: Robot, logs: Logs, linked: bool
) -> None:
    robot.set_motion_timing(driving=3600.0)
    assert wait_future(drive(robot, 0.1)).ok
    if linked:
        robot.chassis.refuse(TWIST, "the key switch is off")
    else:
        robot.chassis.stop_listening()
        robot.wait_lost()
    robot.agent.close()
    record = logs.wait_text("the robot was not stopped")
    assert record.levelname == "ERROR"
    assert "emergency stop" in record.getMessage()
    assert ("the key switch is off" in record.getMessage()) == linked
