"""cmd_vel: the robot drives while velocities are repeated, and is stopped when they end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped
from std_srvs.srv import Trigger

from tests.harness import TIMEOUT, Robot, wait_until
from tests.node.cmd_vel import Sender
from tests.node.goals import CANCELED, step
from woosh_robot_agent.parameters import StandardSettings
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import DeviceState, Mode
from woosh_robot_msgs.srv import Speak

MODE = "woosh.robot.Mode"
TWIST = "woosh.robot.Twist"


@pytest.fixture
def sender(shared_robot: Robot) -> Iterator[Sender]:
    """A publisher of velocities to the agent that tests of this file share."""
    sender = Sender(shared_robot)
    yield sender
    sender.pause()


@pytest.fixture
def twists(simulator: SimulatorThread) -> Callable[[], list[tuple[float, float, float]]]:
    """Function that returns the velocities the chassis has received: linear, linear_y, angular."""

    def read() -> list[tuple[float, float, float]]:
        return [
            (m.linear, m.linear_y, m.angular)
            for m in (each.message for each in simulator.received if each.type == TWIST)
        ]

    return read


@pytest.fixture
def arrivals(simulator: SimulatorThread) -> list[tuple[float, bool]]:
    """Arrival time of each velocity at the chassis, and True if it was zero."""
    times: list[tuple[float, bool]] = []
    chassis = simulator.call(lambda running: running)  # `note` is called in its thread

    def note(frame: Any) -> list[Any]:
        if frame.request == TWIST:
            sent: Any = chassis.last(TWIST)
            times.append((time.monotonic(), not (sent.linear or sent.linear_y or sent.angular)))
        return [frame]

    simulator.intercept(note)
    return times


@pytest.fixture
def all_sent(shared_robot: Robot) -> Callable[[], None]:
    """Function that returns when cmd_vel has sent to the chassis what it had to send.

    Then a timer that is due after its watchdog has fired in the same thread, and the chassis has
    answered a request that was sent after that.
    """

    def wait() -> None:
        thread = shared_robot.agent.agent.robot.thread
        thread.run(asyncio.sleep(StandardSettings().cmd_vel_timeout), TIMEOUT)
        assert shared_robot.call(Speak, "robot/Speak").ok

    return wait


def test_one_zero_after_the_last_velocity_and_then_silence(sender, twists, arrivals, all_sent):
    delays = []
    # repeated, because a busy machine may note the end of the sender too late
    for times in range(1, 4):
        before = len(arrivals)
        sender.repeat(20, x=0.3)
        wait_until(lambda: len(arrivals) >= before + 5)  # noqa: B023
        end = sender.pause()
        wait_until(lambda: arrivals[-1][1], "the zero")
        delays.append(arrivals[-1][0] - end)
        count = len(arrivals)
        all_sent()
        assert len(arrivals) == count
        assert twists().count((0.0, 0.0, 0.0)) == times
    assert max(delays) > 0.3, "only after cmd_vel_timeout"


def test_zeros_of_an_idle_sender_are_not_sent(simulator, sender, shared_robot, twists):
    """twist_mux and joysticks send zeros all the time."""
    goal = step(shared_robot, 20.0)
    simulator.wait_received("woosh.ros.CallAction")
    sender.repeat(50)
    goal.feedback.wait_count(3)
    assert not goal.done
    assert not twists()
    sender.pause()


def test_a_velocity_arrives_in_ros_axes_and_is_scaled_down_to_the_limits(
    simulator, connect, client, twists
):
    connect(cmd_vel_max_linear=0.5, cmd_vel_max_angular=0.2)
    Sender(client).send(3.0, -4.0, 9.0)
    simulator.wait_received(TWIST)
    assert twists()[0] == pytest.approx((0.3, -0.4, 0.2)), "the direction stays"


class TestRefused:
    def test_a_stamp_that_is_stale_or_in_the_future_is_refused_unless_the_velocity_is_zero(
        self, simulator, connect, client, twists, logs
    ):
        connect(cmd_vel_stamped=True, cmd_vel_timeout=5.0)
        sender = Sender(client, TwistStamped)
        sender.send_stamped(0.4, age=3.0)
        logs.wait_text("cmd_vel_max_age")
        for age in (-3600.0, time.time() + 5.0):  # in an hour, and before 1970
            logs.messages.clear()
            sender.send_stamped(0.4, age=age)
            logs.wait_text("cmd_vel is ignored", "check the sender's clock")
        assert simulator.counts[TWIST] == 0
        assert not [record for record in logs.messages if record.exc_info]
        sender.send_stamped(0.1, age=0.0)
        simulator.wait_received(TWIST)
        assert twists()[0] == pytest.approx((0.1, 0.0, 0.0))
        sender.send_stamped(0.0, age=3.0)
        simulator.wait_received(TWIST, 2, timeout=4.0)  # before the velocity times out
        assert twists()[1] == (0.0, 0.0, 0.0)

    def test_without_simulated_time_it_is_not_the_senders_clock(self, connect, client, logs):
        connect(cmd_vel_stamped=True, use_sim_time=True)
        Sender(client, TwistStamped).send_stamped(0.4, age=0.0)
        logs.wait_text("cmd_vel is ignored: use_sim_time is true, but no time has come on /clock")

    def test_velocities_are_refused_while_a_goal_runs(
        self, simulator, sender, shared_robot, twists, logs
    ):
        goal = step(shared_robot, 20.0)
        simulator.wait_received("woosh.ros.CallAction")
        sender.send(x=0.3)
        logs.wait_text("cmd_vel_override")
        goal.cancel()
        assert goal.result()[0] == CANCELED
        sender.send(x=0.1)
        simulator.wait_received(TWIST)
        assert twists()[0] == pytest.approx((0.1, 0.0, 0.0))


class TestLinkLoss:
    def test_a_driving_robot_gets_a_zero_when_the_link_is_back(
        self, simulator, connect, client, twists
    ):
        # with a shorter one, the robot might be stopped already when the link is lost
        agent = connect(cmd_vel_timeout=5.0)
        sender = Sender(client)
        sender.send(x=0.3)
        simulator.wait_received(TWIST)
        simulator.stop_listening()
        wait_until(lambda: agent.agent.debug()["state"] != "ready", "the loss")
        sender.send(x=0.4)  # there is no link, and this must not be sent later
        simulator.listen()
        agent.wait_connected(2)
        simulator.wait_received(TWIST, 2)
        assert client.call(Speak, "robot/Speak").ok  # what came before has been sent
        assert twists() == [pytest.approx((0.3, 0.0, 0.0)), (0.0, 0.0, 0.0)]
        sender.send(x=0.1)
        simulator.wait_received(TWIST, 3)


class TestStop:
    def test_velocities_with_stale_stamps_are_no_pause(
        self, simulator, connect, client, twists, logs
    ):
        agent = connect(cmd_vel_stamped=True)
        gate = agent.agent.robot.gate
        gate.timing = replace(gate.timing, pause=3.0)
        sender = Sender(client, TwistStamped)
        sender.send_stamped(0.3, age=0.0)
        simulator.wait_received(TWIST)
        assert client.call(Trigger, "stop").success
        longer_than_a_pause = time.monotonic() + 3.5
        while time.monotonic() < longer_than_a_pause:
            sender.send_stamped(0.3, age=60.0)  # after a jump of the clock, for example
            time.sleep(0.3)
        logs.wait_text("cmd_vel_max_age")
        sender.send_stamped(0.3, age=0.0)
        logs.wait_text("the robot was stopped")
        # two zeros on a slow machine: the velocity had timed out before the stop
        assert set(twists()[1:]) == {(0.0, 0.0, 0.0)}


class TestRelease:
    """What keeps a robot from obeying ends while the sender goes on."""

    @pytest.mark.parametrize("is_lost", [False, True], ids=["with a link", "during a lost link"])
    def test_the_release_of_the_emergency_stop_moves_nothing(
        self, simulator, connect, client, twists, logs, is_lost
    ):
        def slowly(*speeds: float) -> None:
            for speed in speeds:
                sender.send(x=speed)
                time.sleep(0.1)  # the subscription keeps the last message only

        agent = connect()
        states = client.echo(DeviceState, "robot/DeviceState")
        sender = Sender(client)
        sender.repeat(20, x=0.3)
        simulator.wait_received(TWIST)
        if is_lost:
            simulator.stop_listening()
            wait_until(lambda: agent.agent.debug()["state"] != "ready", "the loss")
        simulator.set_emergency_stop(True)
        if is_lost:
            simulator.listen()
        logs.wait_text("then release the button; send a zero velocity, or nothing for 2 s")
        sender.pause()
        before = len(twists())
        slowly(0.0, 0.3)  # the same if it begins anew before the release
        states.messages.clear()
        simulator.set_emergency_stop(False)
        states.wait(lambda state: not state.hardware)
        slowly(0.3, 0.3)
        assert not any(x for x, _, _ in twists()[before:])

        def drives_again() -> bool:
            slowly(0.0, 0.3)  # the zero may be lost: the subscription keeps the last message only
            return any(x for x, _, _ in twists()[before:])

        wait_until(drives_again)

    def test_a_stream_has_to_begin_anew_in_another_control_mode(
        self, simulator, connect, client, twists, logs
    ):
        def drives_after_a_zero(count: int) -> bool:
            sender.send()
            time.sleep(0.1)  # the subscription keeps the last message only: the zero may be lost
            return any(x for x, _, _ in twists()[count:])

        connect()
        sender = Sender(client)
        sender.repeat(20, x=0.3)
        simulator.wait_received(TWIST)
        for mode in (2, 1):
            assert client.command("robot/SwitchControlMode", mode=mode).ok
            logs.wait_text("cmd_vel is ignored: the control mode of the robot has changed")
            logs.messages.clear()
            wait_until(partial(drives_after_a_zero, len(twists())))
        sender.pause()

    def test_a_stream_that_begins_after_a_change_of_the_control_mode_goes_on(
        self, simulator, connect, client, twists
    ):
        """Even if the robot reports the change later than it answers."""
        connect(cmd_vel_timeout=5.0)
        modes = client.echo(Mode, "robot/Mode")
        simulator.intercept(
            lambda out: [replace(out, delay=0.0 if out.is_answer or out.type != MODE else 0.5)]
        )
        assert client.command("robot/SwitchControlMode", mode=2).ok
        sender = Sender(client)
        sender.send(x=0.3)
        modes.wait(lambda mode: mode.ctrl.value == 2)
        sender.send(x=0.3)
        simulator.wait_received(TWIST, 2)
        assert all(x for x, _, _ in twists())
