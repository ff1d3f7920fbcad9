"""No number, enum or text from a hostile chassis ends the link, fails a callback or fills the log.

The chassis is scripted, behind a real socket; the agent is the real node with the whole standard
layer, and all its topics have subscribers. All fields of one type get each extreme value at once,
and each field alone gets one of them.
"""

from __future__ import annotations

import asyncio
import base64
import io
import itertools
import json
import logging
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from PIL import Image
from rclpy.qos import QoSProfile

from tests.convert.random_messages import (
    EXTREMES,
    HUGE,
    body_with,
    extremes,
    item_type,
    leaves,
    merged,
)
from tests.harness import TIMEOUT, Client, Collector, Logs, RunningAgent, wait_until
from tests.node.tasks.scripted_chassis import (
    EXEC_TASK,
    ROBOT_INFO,
    TASK_PROC,
    Body,
    ScriptedChassis,
)
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneList
from woosh_robot_agent.ros.standard import map as map_part
from woosh_robot_agent.ros.standard_endpoints import STANDARD, Kind

NAV_PATH = "woosh.robot.NavPath"
POSE_SPEED = "woosh.robot.PoseSpeed"
MODEL = "woosh.robot.Model"
SCANNER = "woosh.robot.ScannerData"
SCENE = "woosh.robot.Scene"
SCENE_DATA = "woosh.map.SceneData"
FEEDBACKS = "woosh.ros.Feedbacks"
PUSHES = (*(topic.push for topic in TOPICS), FEEDBACKS)

_IMAGE = io.BytesIO()
Image.new("L", (3, 2), 254).save(_IMAGE, "PNG")
_PNG = base64.b64encode(_IMAGE.getvalue()).decode()
GOOD: dict[str, Body] = {
    SCANNER: {"angleMin": -1.0, "angleMax": 1.0, "angleIncrement": 1.0, "rangeMin": 0.1}
    | {"rangeMax": 30.0, "ranges": [1.0, 2.0, 3.0], "offset": {"x": 0.1, "y": 0.0, "z": 0.2}},
    SCENE_DATA: {"name": "s", "maps": [{"id": 1, "name": "m", "resolution": 0.05, "mapPng": _PNG}]},
    NAV_PATH: {"path": {"poses": [{"x": 1.0, "y": 2.0, "theta": 0.5}]}},
    POSE_SPEED: {"pose": {"x": 1.0, "y": 2.0, "theta": 0.5}, "mapId": 1},
    MODEL: {"model": [{"x": 1.0, "y": 1.0}, {"x": -1.0, "y": 1.0}, {"x": 0.0, "y": -1.0}]},
}
"""Values as real robots send them."""


def numbers_of(message: Any) -> Iterator[float]:
    """Yield the floating-point numbers in a ROS message, without the ranges of a scan."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind in ("float", "double"):
            yield value
        elif "/" in kind:
            for inner in value if item_type(kind) else [value]:
                yield from numbers_of(inner)


class HostileChassis(ScriptedChassis):
    """A scripted chassis that also decides on its RobotInfo, and sends any text."""

    def _value(self, name: str) -> Body:
        return {**super()._value(name), **self._values.get(name, {})}

    def send(self, frame: str) -> None:
        """Send a frame to all clients."""
        self.at_once(lambda: [client.send(frame) for client in self._clients])  # type: ignore[arg-type,func-returns-value]


class Rig:
    """The hostile chassis, the agent and a subscriber of each of its topics.

    Attributes:
        chassis: the chassis.
        agent: the node.
        topics: the received messages of each topic, by its name.
    """

    def __init__(self, chassis: HostileChassis, agent: RunningAgent, client: Client) -> None:
        self.chassis = chassis
        self.client = client
        self.agent = agent.agent
        self.link = agent.agent.robot.chassis
        self.topics: dict[str, Collector] = {}
        for topic in TOPICS:
            self.topics[topic.name] = client.echo(class_of(topic.msg), topic.name)
        for endpoint in STANDARD:
            if endpoint.kind in (Kind.STREAM, Kind.LATCHED):
                self.topics[endpoint.name] = client.echo_with(
                    class_of(endpoint.type), endpoint.name, QoSProfile(depth=100)
                )
        wait_until(lambda: set(PUSHES) <= chassis.subscribed, "subscriptions")

    def push(self, name: str, *bodies: Body) -> None:
        """Push values, and wait until the agent has handled them."""
        self.send(*(json.dumps({"type": name, "body": body}) for body in bodies))

    def send(self, *frames: str) -> None:
        """Send frames, and wait until the agent has handled them."""
        for start in range(0, len(frames), 25):  # of more, the oldest could be dropped
            for frame in frames[start : start + 25]:
                self.chassis.send(frame)
            self.settle()

    def settle(self) -> None:
        """Wait until the agent has handled all that the chassis has sent."""

        async def ask() -> None:
            done = asyncio.get_running_loop().create_future()
            await self.link.request(SceneList(), tap=done.set_result)
            await done

        self.agent.robot.thread.run(ask(), TIMEOUT)

    def check_topics(self) -> None:
        """Check that the numbers on the topics of the standard layer are finite."""
        for endpoint in STANDARD:
            if (
                endpoint.kind in (Kind.STREAM, Kind.LATCHED) and endpoint.name != "battery_state"
            ):  # NaN is unknown there
                for message in list(self.topics[endpoint.name].messages):
                    assert all(map(math.isfinite, numbers_of(message))), message

    def reconnect(self, info: Body) -> None:
        """Let the agent connect again, and answer its request for RobotInfo."""
        self.chassis.keep(ROBOT_INFO, info)
        connects = self.link.stats.connects
        self.chassis.vanish()
        self.chassis.listen()
        wait_until(lambda: self.link.stats.connects > connects, "the link")
        self.settle()


@pytest.fixture
def rig(
    frequent: None, start_agent: Any, client: Client, monkeypatch: pytest.MonkeyPatch, logs: Logs
) -> Iterator[Rig]:
    monkeypatch.setattr(map_part, "_RETRY_DELAY", 0.02)
    handler = logging.Handler()
    handler.emit = logs.add  # type: ignore[method-assign]
    logging.getLogger("asyncio").addHandler(handler)
    with HostileChassis() as chassis:
        agent = start_agent(
            ip="127.0.0.1",
            port=chassis.port,
            backoff_min=0.05,
            backoff_max=0.05,
            publish_tf=True,
            publish_laser_tf=True,
            scan_rate=20.0,
        )
        agent.wait_connected()
        yield Rig(chassis, agent, client)
    logging.getLogger("asyncio").removeHandler(handler)


def check_log(logs: Logs, *expected: str) -> None:
    """Check that nothing has failed, and that nothing was said twice.

    Args:
        logs: records of the agent.
        expected: beginnings of warnings and errors that are in order.
    """
    records = [r for r in logs.messages if not r.getMessage().startswith(expected)]
    failed = [r.getMessage() for r in records if r.exc_info or r.levelno > logging.WARNING]
    assert not failed, Counter(failed)
    told = Counter(r.getMessage() for r in records if r.levelno == logging.WARNING)
    assert not {text: count for text, count in told.items() if count > 1}


def alone(name: str) -> Iterator[Body]:
    """Yield a body for each field of a type, in which only that field has an extreme value."""
    turns = {kind: itertools.cycle(values) for kind, values in EXTREMES.items()}
    for path, kind in leaves(message_type(name).DESCRIPTOR):
        if not any(part.endswith("_info") for part in path):  # marks, which the agent does not use
            yield body_with(path, next(turns[kind]))


def test_no_value_in_a_push_does_harm(rig: Rig, logs: Logs):
    for name in PUSHES:
        bad = rig.link.stats.bad_frames["body"]
        rig.push(name, *extremes(name), *alone(name))
        assert rig.link.stats.bad_frames["body"] > bad
    assert rig.link.stats.connects == 1
    check_log(logs)
    rig.check_topics()


def test_no_value_in_robot_info_does_harm(rig: Rig, logs: Logs):
    for info in extremes(ROBOT_INFO):
        logs.messages.clear()  # each link logs bad values again
        genral = {**info.get("genral", {}), "serial_number": 0}  # another robot would be refused
        rig.reconnect({**info, "robot_id": 10001, "genral": genral})
        # the map of the former link's scene may be requested on both links
        check_log(logs, "the link", "connected", "cannot connect", "no map")
    rig.check_topics()


def test_no_value_in_an_answer_does_harm(rig: Rig, logs: Logs):
    """The agent requests scans and maps by itself."""
    for name in (SCANNER, SCENE_DATA):
        for number, body in enumerate((*alone(name), *extremes(name))):
            rig.chassis.keep(name, merged(GOOD[name], body))
            requests = rig.chassis.count(name)
            if name == SCENE_DATA:
                scene = {"sceneName": "s", "mapName": "m", "mapId": 1, "version": number}
                rig.push(SCENE, scene)
            rig.chassis.wait_request(name, requests + (2 if name == SCANNER else 1))
            rig.settle()
    check_log(logs)
    rig.check_topics()


BAD = [
    (NAV_PATH, ("path", "poses", "[]", "x"), "robot/NavPath", "plan"),
    (MODEL, ("model", "[]", "y"), "robot/Model", "footprint"),
    (POSE_SPEED, ("twist", "angular"), "robot/PoseSpeed", "odom"),
]


def test_a_value_that_a_standard_message_cannot_hold_is_counted_logged_once_and_skipped(
    rig: Rig, logs: Logs
):
    """The mirrored message holds it, as ROS permits; the next good value is published as ever."""
    for name, path, mirrored, derived in BAD:
        received = rig.topics[mirrored]
        begun = len(received.messages)
        counted = rig.link.stats.bad_frames["value"]
        for number, value in enumerate((math.inf, math.nan, -math.inf)):
            rig.push(name, merged(GOOD[name], body_with(path, value)))
            received.wait_count(begun + 2 * number + 1)  # a latched topic keeps the last message
            rig.push(name, GOOD[name])
            received.wait_count(begun + 2 * number + 2)
        assert rig.link.stats.bad_frames["value"] == counted + 3
        assert len(logs.with_text(f"skipped a bad value in {name}: ", "WARNING")) == 1
        odd = [m for m in received.messages[begun:] if not all(map(math.isfinite, numbers_of(m)))]
        assert len(odd) == 3
        before = len(rig.topics[derived].messages)
        rig.push(name, GOOD[name])
        rig.topics[derived].wait_count(before + 1)
    rig.check_topics()
    # a frame is used without a bad time: an answer must not be lost because of the robot's clock
    poses = rig.topics["robot/PoseSpeed"]
    begun = len(poses.messages)
    for value in (HUGE, -1, 2**63, "soon"):
        rig.send(json.dumps({"type": POSE_SPEED, "body": GOOD[POSE_SPEED], "timestamp": value}))
    poses.wait_count(begun + 4)
    assert rig.link.stats.bad_frames["timestamp"] == 4
    assert rig.link.stats.clock_offset is None
    assert len(logs.with_text("timestamp is out of range", "WARNING")) == 1


def test_the_robot_still_counts_as_standing_after_a_pose_that_is_none(
    rig: Rig, client: Client, logs: Logs
):
    twist = class_of("woosh_robot_msgs/Twist", "srv")
    begin = merged(GOOD[POSE_SPEED], {"pose": {"theta": math.inf}})
    for start in (begin, GOOD[POSE_SPEED]):
        rig.push(POSE_SPEED, start)
        arg = twist.Request().arg
        arg.linear = 0.2
        assert client.call(twist, "robot/Twist", arg=arg).ok
        rig.push(POSE_SPEED, *alone(POSE_SPEED), *extremes(POSE_SPEED))
        rig.push(POSE_SPEED, GOOD[POSE_SPEED])
        assert client.call(twist, "robot/Twist").ok
    check_log(logs)


def test_no_value_in_a_report_on_a_goal_does_harm(rig: Rig, client: Client, logs: Logs):
    execute = class_of("woosh_robot_msgs/ExecTask", "action")
    goal = execute.Goal()
    goal.arg.task_id, goal.arg.mark_no, goal.arg.type.value = 5, "A2", 1
    running = client.send_goal(execute, "robot/ExecTask", goal)
    rig.chassis.wait_request(EXEC_TASK)
    for body in extremes(TASK_PROC):
        rig.push(TASK_PROC, {"state": 3, **body, "robotTaskId": "5"})
        rig.push(FEEDBACKS, {"fbs": [{"action": "woosh.ros.action.MoveBase", **body}]})
    rig.push(TASK_PROC, {"robotTaskId": "5", "state": 3})
    rig.push(TASK_PROC, {"robotTaskId": "5", "state": 7})
    status, result = running.result()
    assert status == GoalStatus.STATUS_SUCCEEDED, result.ret.msg
    check_log(logs)


def test_reports_on_actions_that_do_not_exist_are_not_kept(rig: Rig) -> None:
    names = ("woosh.ros.action.MoveBase", *(f"woosh.ros.action.Unknown{n}" for n in range(50)))
    rig.push(FEEDBACKS, *({"fbs": [{"action": name, "state": 2}]} for name in names))
    assert set(rig.agent.actions._last_feedback) == {names[0]}
