"""`record --ros` records what the agent publishes, as rosbag2 does."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import deserialize_message

from tests.harness import wait_until
from tests.interface_facts import HASHES
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_msgs.msg import Mode

TIMEOUT = 60.0


def count(path: Path, topic: str) -> int:
    """Return the number of messages of a topic in a file that is being written."""
    if not path.exists():
        return 0
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


def test_ros_topics_are_recorded(
    tmp_path: Path, simulator: Any, start_agent: Any, client: Any
) -> None:
    agent = start_agent(ip="127.0.0.1", port=simulator.port)
    agent.wait_connected()
    path, ros = tmp_path / "a.mcap", tmp_path / "a_ros.mcap"
    mode = client.path("robot/Mode")
    namespace = mode.removesuffix("/robot/Mode")
    process = subprocess.Popen(
        [sys.executable, "-m", "woosh_robot_agent.tools.record", "--ip", "127.0.0.1"]
        + ["--port", str(simulator.port), "--output", str(path), "--ros", namespace],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        wait_until(lambda: count(ros, mode) >= 1, "the latched message", TIMEOUT)
        wait_until(lambda: count(ros, f"{namespace}/odom") >= 10, "odom", TIMEOUT)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=TIMEOUT)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0, out
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
    assert channel.metadata["topic_type_hash"] == HASHES["woosh_robot_msgs/msg/Mode"]
    odometry = found[f"{namespace}/odom"][0].data.decode()
    for name in ("std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Quaternion"):
        assert f"\n{'=' * 80}\nMSG: {name}\n" in odometry
    assert "/diagnostics" in found
    assert not [topic for topic in found if "/_" in topic]
