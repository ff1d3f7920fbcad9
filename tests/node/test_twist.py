"""Velocity commands through robot/Twist: the newest wins, and a stale one is never sent."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from tests.harness import Client, Collector, RunningAgent, wait_future, wait_until
from tests.node.goals import EXECUTING, slow_down, stop_time, task
from woosh_robot_agent.motion import gate, timeliness
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import Mode, Twist

TWIST = "woosh.robot.Twist"
ROBOT_INFO = "woosh.robot.RobotInfo"

pytestmark = pytest.mark.usefixtures("agent")


def drive(client: Client, linear: float) -> Any:
    """Command a velocity; return the future of the answer."""
    return client.call_async(Twist, "robot/Twist", arg=TwistMsg(linear=linear))


def answers(futures: list[Any]) -> list[Any]:
    return [wait_future(future) for future in futures]


def speeds(simulator: SimulatorThread) -> list[float]:
    """Return the linear velocities that the chassis has received."""
    twists = [each.message for each in simulator.received if each.type == TWIST]
    return [round(twist.linear, 4) for twist in twists]


def test_velocities_arrive_in_order(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(timeliness, "MAX_AGE", 3600.0)  # none is stale, even on a slow machine
    wanted = [round(0.01 * i, 4) for i in range(1, 31)]
    given = answers([drive(client, linear) for linear in wanted])
    assert all(answer.ok for answer in given)
    assert speeds(simulator) == wanted


def test_the_last_velocity_is_not_repeated(client: Client, simulator: SimulatorThread) -> None:
    before = simulator.state.odometer
    answers([drive(client, 0.4)])
    wait_until(lambda: simulator.state.odometer > before)
    wait_until(lambda: simulator.state.velocity.forward == 0)
    assert speeds(simulator) == [0.4]


def test_zero_stops_at_once(client: Client, simulator: SimulatorThread) -> None:
    answers([drive(client, 0.4), drive(client, 0.0)])
    assert speeds(simulator) == [0.4, 0.0]
    wait_until(lambda: simulator.state.velocity.forward == 0)


def test_nan_is_not_sent(client: Client, simulator: SimulatorThread) -> None:
    (answer,) = answers([drive(client, math.nan)])
    assert not answer.ok
    assert "arg.linear" in answer.msg
    assert speeds(simulator) == []


@pytest.mark.parametrize("field", ["linear", "linear_y", "angular"])
@pytest.mark.parametrize("value", [3e38, -10.5])
def test_a_velocity_that_no_robot_reaches_is_not_sent(
    client: Client, simulator: SimulatorThread, field: str, value: float
) -> None:
    answer = client.call(Twist, "robot/Twist", arg=TwistMsg(**{field: value}))
    assert not answer.ok
    assert f"arg.{field} is {value:g}" in answer.msg
    assert "nothing was sent" in answer.msg
    assert simulator.counts[TWIST] == 0


def test_the_limits_of_cmd_vel_hold_for_calls(client: Client, simulator: SimulatorThread) -> None:
    def sent(**velocity: float) -> tuple[Any, ...]:
        answer = client.call(Twist, "robot/Twist", arg=TwistMsg(**velocity))
        assert answer.ok
        twist = simulator.last(TWIST)
        return *(round(v, 4) for v in (twist.linear, twist.linear_y, twist.angular)), answer.msg

    *legal, usual = sent(linear=1.0, angular=-1.0)
    assert legal == [1.0, 0.0, -1.0]
    assert "cmd_vel_max" not in usual
    *fast, told = sent(linear=-3.0, angular=5.0)
    assert fast == [-1.0, 0.0, 1.0]
    assert told.startswith(usual)
    assert "cmd_vel_max_linear" in told
    assert sent(linear=3.0, linear_y=4.0)[:3] == (0.6, 0.8, 0.0), "the direction stays"
    lower = {"cmd_vel_max_linear": 0.3, "cmd_vel_max_angular": 0.2}
    parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in lower.items()]
    results = client.call(SetParameters, "agent/set_parameters", parameters=parameters).results
    assert all(result.successful for result in results)
    assert sent(linear=0.3, angular=0.2) == (0.3, 0.0, 0.2, usual)
    assert sent(linear=1.0, angular=-1.0)[:3] == (0.3, 0.0, -0.2)


def test_refusal_reaches_the_client(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(TWIST, "the key switch is off")
    (answer,) = answers([drive(client, 0.4)])
    assert (answer.ok, answer.msg) == (False, "the key switch is off")


def test_newest_velocity_wins_while_the_chassis_does_not_answer(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands queue up neither in the agent nor in the chassis, and none follows the last one."""
    monkeypatch.setattr(timeliness, "MAX_AGE", 2.0)  # the first is not stale even on a slow machine
    simulator.mute(TWIST)
    drive(client, 0.001)
    simulator.wait_received(TWIST)
    begun = time.monotonic()
    wait_until(lambda: time.monotonic() - begun > 2 * timeliness.MAX_AGE)
    calls = [drive(client, 0.001 * i) for i in range(2, 12)]
    *held, last = answers(calls)
    assert not any(answer.ok for answer in (*held, last))
    assert "too old" in last.msg
    assert any("newer" in answer.msg for answer in held)
    client.call(Mode, "robot/Mode")
    assert speeds(simulator) == [0.001], "there is no answer, and none is sent"


def test_velocity_without_a_link_is_refused_and_not_kept(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.stop_listening()
    wait_until(lambda: simulator.connections == 0)
    (answer,) = answers([drive(client, 0.4)])
    assert not answer.ok
    assert "not connected" in answer.msg or "link" in answer.msg
    simulator.listen()
    simulator.wait_received(ROBOT_INFO, 2)
    wait_until(lambda: client.call(Twist, "robot/Twist").ok)
    assert set(speeds(simulator)) == {0.0}


def test_no_velocity_is_repeated_after_a_lost_link(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    simulator.mute(TWIST)
    calls = [drive(client, 0.1), drive(client, 0.2)]
    simulator.wait_received(TWIST, 2)
    simulator.drop()
    for answer in answers(calls):
        assert not answer.ok
        assert answer.msg
    simulator.wait_received(ROBOT_INFO, 2)
    agent.wait_connected()
    client.call(Mode, "robot/Mode")
    assert speeds(simulator) == [0.1, 0.2]


def test_no_stale_velocity_is_sent_after_a_half_open_link(
    client: Client, simulator: SimulatorThread
) -> None:
    answers([drive(client, 0.1)])
    simulator.inject("half_open")
    calls = [drive(client, 0.2)]
    begun = time.monotonic()
    while time.monotonic() - begun < 0.8:
        calls.append(drive(client, 0.3))
        wait_until(lambda: time.monotonic() > begun + 0.02 * len(calls))
    late = drive(client, 0.4)
    assert "too old" in wait_future(late).msg
    simulator.clear_faults()
    stop = wait_future(drive(client, 0.0))
    assert stop.ok
    assert 0.4 not in speeds(simulator)
    assert speeds(simulator)[-1] == 0.0
    wait_until(lambda: simulator.state.velocity.forward == 0)


def test_the_end_of_the_agent_does_not_stop_a_task_that_came_after(
    client: Client,
    simulator: SimulatorThread,
    agent: RunningAgent,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gate, "DRIVING", 3600.0)  # only the task ends the drive
    assert wait_future(drive(client, 0.1)).ok
    slow_down(simulator)
    client_goal = task(client)
    client_goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    stop_time(simulator)
    agent.close()
    assert speeds(simulator) == [0.1]
    assert simulator.state.info.task_proc.state == EXECUTING


def test_the_end_of_the_agent_long_after_a_velocity_sends_nothing(
    client: Client,
    simulator: SimulatorThread,
    agent: RunningAgent,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The chassis has stopped by itself, and another client may drive it now."""
    monkeypatch.setattr(gate, "DRIVING", 0.1)
    assert wait_future(drive(client, 0.1)).ok
    wait_until(lambda: not agent.agent._gate.driving, "the end of the drive")
    agent.close()
    assert speeds(simulator) == [0.1]


def test_the_end_of_the_agent_while_the_robot_drives_without_a_link_is_an_error(
    client: Client,
    simulator: SimulatorThread,
    agent: RunningAgent,
    logs: Collector,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gate, "DRIVING", 3600.0)
    assert wait_future(drive(client, 0.1)).ok
    simulator.stop_listening()
    wait_until(lambda: agent.agent._chassis.state.value != "ready", "the loss")
    agent.close()
    record = logs.wait(lambda record: "the robot was not stopped" in record.getMessage())
    assert record.levelname == "ERROR"
    assert "emergency stop" in record.getMessage()


def test_a_zero_that_the_chassis_refuses_at_the_end_of_the_agent_is_an_error(
    client: Client,
    simulator: SimulatorThread,
    agent: RunningAgent,
    logs: Collector,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gate, "DRIVING", 3600.0)
    assert wait_future(drive(client, 0.1)).ok
    simulator.refuse(TWIST, "the key switch is off")
    agent.close()
    record = logs.wait(lambda record: "the robot was not stopped" in record.getMessage())
    assert record.levelname == "ERROR"
    assert "the key switch is off" in record.getMessage()
