"""`record --ros` records what the agent publishes, as rosbag2 does."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
import yaml
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from tests.harness import HUMBLE, Spinner, wait_until
from tests.tooling.interface_facts import HASHES
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.ros.releases import PublisherEventCallbacks
from woosh_robot_agent.tools.options import ToolError
from woosh_robot_agent.tools.recording import ros_recorder
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_msgs.msg import Mode

TIMEOUT = 60.0


def count(path: Path, topic: str) -> int:
    """Return the number of messages of a topic in a file that is being written."""
    return _count(path, topic, path.stat().st_size) if path.exists() else 0


@lru_cache(maxsize=1)
def _count(path: Path, topic: str, _size: int) -> int:
    """Count again only when the file has grown: to read it takes time that the recorder needs."""
    channels, found = set(), 0
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel) and record.topic == topic:
                    channels.add(record.id)
                found += isinstance(record, Message) and record.channel_id in channels
        except (EndOfFile, ValueError):
            pass
    return found


def test_ros_topics_are_recorded(tmp_path: Path, simulator: Any, connect: Any, client: Any) -> None:
    connect()
    path, ros = tmp_path / "a.mcap", tmp_path / "a_ros.mcap"
    mode = client.path("robot/Mode")
    namespace = mode.removesuffix("/robot/Mode")
    with recorder(simulator, path, namespace) as process:
        wait_until(lambda: count(ros, mode) >= 1, "the latched message", TIMEOUT)
        wait_until(lambda: count(ros, f"{namespace}/odom") >= 10, "odom", TIMEOUT)
        status, out, err = end(process)
    assert status == 0, err
    assert f"ROS messages to {ros}" in out
    assert read_recording(path).records
    with ros.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = {
            channel.topic: (schema, channel, message)
            for schema, channel, message in reader.iter_messages()
        }
        # every message can be decoded with nothing but its schema in the file
        decoded = {
            each.channel.topic: each.decoded_message for each in reader.iter_decoded_messages()
        }
    assert decoded.keys() == found.keys()
    assert decoded[mode].ctrl.value
    assert decoded[f"{namespace}/odom"].child_frame_id
    schema, channel, message = found[mode]
    assert (schema.name, schema.encoding, channel.message_encoding) == (
        "woosh_robot_msgs/msg/Mode",
        "ros2msg",
        "cdr",
    )
    assert deserialize_message(message.data, Mode).ctrl.value
    assert "MSG: woosh_robot_msgs/ControlMode" in schema.data.decode()
    (offered,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert (offered["reliability"], offered["durability"]) == ("reliable", "transient_local")
    type_hash = "" if HUMBLE else HASHES["woosh_robot_msgs/msg/Mode"]
    assert channel.metadata["topic_type_hash"] == type_hash
    odometry = found[f"{namespace}/odom"][0].data.decode()
    for name in ("std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Quaternion"):
        assert f"\n{'=' * 80}\nMSG: {name}\n" in odometry
    assert "/diagnostics" in found
    assert not [topic for topic in found if "/_" in topic]


@pytest.mark.parametrize(("jump", "age"), [(0, 2 * 10**8), (7200, 10**9), (-7200, 0)])
def test_a_jump_of_the_clock_moves_no_message(
    monkeypatch: pytest.MonkeyPatch, jump: int, age: int
) -> None:
    """The file of the frames beside it has the same clock, which does not jump."""
    info = {"received_timestamp": 1800 * 10**15}
    wall_clock = info["received_timestamp"] + 2 * 10**8 + jump * 10**9
    monkeypatch.setattr(ros_recorder, "time", SimpleNamespace(time_ns=lambda: wall_clock))
    now = 1800 * 10**15 + 2 * 10**8
    assert now - ros_recorder.received_at(info, now) == age


@pytest.fixture
def publisher_node(domain: int) -> Iterator[Node]:
    """Return a node in the namespace /fake whose publishers are taken for those of an agent."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = Node("agent", namespace="/fake", context=context)
    agent_topic = TOPICS[0]
    node.create_publisher(class_of(agent_topic.msg), agent_topic.name, 1)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    spinner = Spinner(executor)
    yield node
    spinner.stop()
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@contextmanager
def recorder(simulator: Any, path: Path, namespace: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "woosh_robot_agent.tools", "record"]
        + ["--ip", f"127.0.0.1:{simulator.port}", "--output", str(path), "--ros", namespace],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def end(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """End a recorder; return its exit status, stdout and stderr."""
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=TIMEOUT)
    return process.returncode, out, err


LARGE = String(data="x" * 1_000_000)


def test_messages_that_the_middleware_loses_fail_the_recording(
    tmp_path: Path, simulator: Any, publisher_node: Node
) -> None:
    """Latched messages that are replaced while the recorder subscribes are not lost."""
    path, ros = tmp_path / "a.mcap", tmp_path / "a_ros.mcap"
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers: list[Publisher] = []

    def replace(index: int) -> None:
        publishers[index].publish(String(data="small"))

    for index in range(10):
        options: dict[str, Any] = {}
        if not HUMBLE:  # which has no matched events
            options["event_callbacks"] = PublisherEventCallbacks(
                matched=lambda _, index=index: replace(index)
            )
        publishers.append(publisher_node.create_publisher(String, f"t_{index}", qos, **options))
        publishers[-1].publish(LARGE)
    publisher = publisher_node.create_publisher(String, "large", qos)
    publisher.publish(String(data="first"))
    with recorder(simulator, path, "/fake") as process:
        for topic in ("large", *(f"t_{index}" for index in range(10))):
            wait_until(lambda: count(ros, f"/fake/{topic}") >= 1, "a message", TIMEOUT)  # noqa: B023
        for _ in range(100):  # each replaces the one before, which is still being sent
            publisher.publish(LARGE)
        wait_until(lambda: count(ros, "/fake/large") >= 2, "a large message", TIMEOUT)
        status, _, err = end(process)
    assert status == 1
    (lost,) = [line for line in err.splitlines() if "lost" in line]
    assert lost.startswith("error: messages on /fake/large that the middleware lost: ")


def has_frames(path: Path) -> bool:
    """Return True if a growing file has a frame already."""
    try:
        return bool(read_recording(path).records)
    except ToolError:  # not even its header is complete
        return False


def test_a_recording_without_ros_messages_fails(
    tmp_path: Path, simulator: Any, domain: int
) -> None:
    path = tmp_path / "a.mcap"
    with recorder(simulator, path, "/nobody") as process:
        wait_until(lambda: has_frames(path), "a frame", TIMEOUT)
        status, _, err = end(process)
    assert status == 1
    assert "error: no ROS message was recorded: check that the agent is running" in err
    assert "namespace is that of --ros: /nobody" in err
