"""A robot whose clock is wrong works, and no stamp of a ROS message comes from that clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile

from tests.harness import Client, RunningAgent, wait_until
from tests.node.cmd_vel import Sender
from tests.node.goals import SUCCEEDED, short_task
from tests.quick_chassis import quick_config
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.ros.standard_endpoints import STANDARD, Kind
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import StatusCode
from woosh_robot_msgs.srv import TaskHistory

HOUR = 3600.0
OFFSET = 41 * HOUR
"""Difference between the robot's clock and the real one, in seconds."""
STAMPED = [
    entry
    for entry in STANDARD
    if entry.kind in (Kind.STREAM, Kind.LATCHED) and entry.type != "std_msgs/Bool"
]
"""Topics of the standard layer with a stamp."""


@pytest.fixture
def simulator() -> Iterator[SimulatorThread]:
    config = quick_config(port=0, tcp_port=0, speed=2, clock_offset=OFFSET)
    with SimulatorThread(config) as running:
        yield running


def stamps(message: Any) -> Iterator[float]:
    """Yield all times in a message, in seconds."""
    if isinstance(message, Time):
        yield message.sec + message.nanosec * 1e-9
    elif isinstance(message, list):
        for each in message:
            yield from stamps(each)
    elif hasattr(message, "get_fields_and_field_types"):
        for name in message.get_fields_and_field_types():
            yield from stamps(getattr(message, name))


def test_everything_works_and_no_stamp_comes_from_the_robot(
    simulator: SimulatorThread,
    connect: Callable[..., RunningAgent],
    client: Client,
) -> None:
    begin = time.time()
    echoes = {}
    for entry in STAMPED:
        latched = entry.kind is Kind.LATCHED
        subscribe = client.echo if latched else partial(client.echo_with, qos=QoSProfile(depth=100))
        echoes[entry.name] = subscribe(class_of(entry.type, "msg"), entry.name)
    codes = client.echo(StatusCode, "robot/StatusCode")
    connect(publish_tf=True)

    status, proc = short_task(client, 0.5).result()
    assert (status, proc.state.value) == (SUCCEEDED, 7)
    sender = Sender(client)

    def turns() -> bool:
        sender.send(turn=0.5)
        return simulator.state.velocity.turn > 0.1

    wait_until(turns, "motion")
    simulator.inject("emergency_stop")

    # What the chassis reports keeps the robot's times.
    stop = codes.wait(lambda code: code.code == 110201000013)
    assert abs(stop.time / 1000 - begin - OFFSET) < HOUR
    (task,) = client.call(TaskHistory, "robot/TaskHistory").info.tes
    assert abs(task.time - begin - OFFSET) < HOUR

    for name, echo in echoes.items():
        echo.wait(lambda message: True)
        found = [stamp for message in echo.messages for stamp in stamps(message)]
        assert found, name
        late = [stamp for stamp in found if stamp and not begin <= stamp <= time.time()]
        assert not late, (name, late)
