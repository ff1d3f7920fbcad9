"""Runs with the same seed and script push the same frames, at any speed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from google.protobuf import json_format

from tests.simulator.recorded_chassis import SCANNER_DATA, SteppedChassis
from tests.simulator.sim_wire import Json, connected
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.protocol.handlers import dispatch
from woosh_robot_agent.simulator.protocol.reports import TOPICS

Command = Callable[[Chassis], None]

COMPLETED = 7


def ask(name: str, **body: Any) -> Command:
    """Return a command that executes a request, which must succeed."""

    def execute(chassis: Chassis) -> None:
        message = json_format.ParseDict(body, message_type(name)())
        answer = dispatch(chassis, message)
        assert answer.ok, answer.msg

    return execute


def put(name: str, x: float, y: float) -> Command:
    return lambda chassis: chassis.obstacles.put(name, x, y)


STEPS = [{"mode": 1, "value": 0.5}, {"mode": 2, "value": 1.57}, {"mode": 3, "value": 0.3}]

SCRIPT: list[tuple[float, Command]] = [
    (1.0, ask("woosh.robot.ExecTask", taskId=11, type=4, direction=1, markNo="K10")),
    (30.0, ask("woosh.ros.CallAction", stepControl={"action": 1, "steps": STEPS})),
    (
        32.0,
        ask("woosh.ros.CallAction", liftControl3={"action": 1, "executeMode": 1, "height": 0.4}),
    ),
    (45.0, ask("woosh.robot.ExecTask", type=1, markNo="A2")),
    (47.0, lambda chassis: chassis.set_emergency_stop(True)),
    (50.0, lambda chassis: chassis.set_emergency_stop(False)),
    (51.0, ask("woosh.robot.ActionOrder", order=5)),
    (75.0, ask("woosh.robot.ExecTask", type=1, pose={"x": -2.0, "y": 4.0})),
    (76.0, put("box", 1.5, 4.0)),
    (110.0, lambda chassis: chassis.obstacles.remove("box")),
    (111.0, ask("woosh.robot.ExecPreTask", taskSetId=777)),
    (150.0, ask("woosh.robot.ActionOrder", order=3)),
    (200.0, ask("woosh.robot.Twist", linear=0.3, angular=0.3)),
    (200.3, ask("woosh.robot.Twist", linear=0.3, linear_y=0.1)),
    (205.0, lambda chassis: chassis.lose_localisation()),
    (206.0, ask("woosh.robot.SetRobotPose", pose={"x": 0.0, "y": 0.0})),
    (207.0, lambda chassis: chassis.set_key_switch(True)),
    (208.0, lambda chassis: chassis.set_key_switch(False)),
    (209.0, put("leader", 2.5, 0.5)),
    (210.0, ask("woosh.robot.Follow", type=True)),
    (220.0, ask("woosh.robot.Follow")),
    (221.0, lambda chassis: setattr(chassis.battery, "level", 50.0)),
    (222.0, ask("woosh.robot.SetOccupancy", occupy=True)),
]
"""Requests, by the simulated second at which they are sent."""
END_S = 222.5
"""End of the runs in simulated seconds."""


OPTIONS = {"profile": "instant", "seed": 7, "park_after": 4.0}


class ScriptPlayer:
    """Executes the commands of the script when they are due."""

    def __init__(self) -> None:
        self._left = list(SCRIPT)

    def play(self, chassis: Chassis) -> None:
        while self._left and self._left[0][0] <= chassis.elapsed + 1e-9:
            self._left.pop(0)[1](chassis)


def pushes_without_sockets() -> list[Json]:
    """Return all pushes of a run that is stepped by hand."""
    stepped, player = SteppedChassis(**OPTIONS), ScriptPlayer()
    while stepped.chassis.elapsed < END_S:
        player.play(stepped.chassis)
        stepped.run(TIME_STEP)
    return stepped.raw


def pushes_over_a_socket(monkeypatch: pytest.MonkeyPatch, speed: float) -> list[Json]:
    """Return all pushes of a run over a socket that starts once the client has subscribed."""
    subscribed, player, tick = threading.Event(), ScriptPlayer(), Chassis.tick

    def gated(chassis: Chassis, dt: float) -> None:
        if subscribed.is_set() and chassis.elapsed < END_S:
            player.play(chassis)
            tick(chassis, dt)

    with monkeypatch.context() as patched:
        patched.setattr(Chassis, "tick", gated)
        with connected(speed=speed, **OPTIONS) as client:
            client.subscribe(*sorted(TOPICS - {SCANNER_DATA}))
            subscribed.set()
            frames = [client.receive()]
            while not is_last(frames[-1]):
                frames.append(client.receive())
    return frames


def is_last(frame: Json) -> bool:
    """Return True for the push about the occupancy, with which the script ends."""
    return frame["type"] == "woosh.robot.DeviceState" and bool(frame["body"]["software"] & 8)


def test_run_over_a_socket_pushes_the_same_frames_as_one_without_a_clock(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = pushes_without_sockets()
    ends = [frame["body"] for frame in frames if frame["type"] == "woosh.robot.TaskProc"]
    assert len({each["robotTaskId"] for each in ends if each["state"] == COMPLETED}) == 6
    assert pushes_over_a_socket(monkeypatch, 100.0) == frames
