"""Record ROS topics, with the definitions of their types, as rosbag2 stores them."""

from __future__ import annotations

import logging
import os
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.ros.releases import SubscriptionEventCallbacks, type_hash
from woosh_robot_agent.tools.options import ToolError
from woosh_robot_agent.tools.recording.files import Limits, RecordingFiles
from woosh_robot_agent.tools.recording.layout import ROS_PROFILE, Channel
from woosh_robot_agent.tools.ros_node import NodeThread, find_agents

_TYPE = re.compile(r"(\w+)/(\w+)")
"""Package and name of a message type within the type of a field."""
_SEPARATOR = "=" * 80
"""Line before each definition except the first, as rosbag2 expects it."""


def definition(name: str) -> str:
    """Return the definitions of a message type and of all types that it uses, in one text.

    Args:
        name: package and name of the type, e.g. `nav_msgs/Odometry`.

    Raises:
        ToolError: the definition of one of the types cannot be read.
    """
    parts: list[str] = []
    for each in _with_dependencies(name):
        package, short = each.split("/")
        try:
            path = Path(get_package_share_directory(package)) / "msg" / f"{short}.msg"
            text = path.read_text("utf-8")
        except (PackageNotFoundError, OSError) as error:
            raise ToolError(f"the definition of {each} cannot be read: {error}") from None
        parts.append(f"{_SEPARATOR}\nMSG: {each}\n{text}" if parts else text)
    return "\n".join(parts)


def _with_dependencies(name: str) -> list[str]:
    """Return a type and all types that it uses, directly or not, each once."""
    found = [name]
    for each in found:  # which grows in the loop
        try:
            cls: Any = class_of(each)
        except (ImportError, AttributeError) as error:
            raise ToolError(f"the type {each} is not installed: {error}") from None
        for field in cls.get_fields_and_field_types().values():
            used = _TYPE.search(field)
            if used and used[0] not in found:
                found.append(used[0])
    return found


_LOG = logging.getLogger(__name__)
_DISCOVERY_PERIOD = 0.5
"""Time between two searches for topics, in seconds."""
_FLUSH_PERIOD = 1.0
"""Time between two flushes of the file, in seconds."""
_DEPTH = 1000
"""Maximum number of messages of a topic that wait for the recorder; older messages are lost."""
_MAX_AGE = 10**9
"""Maximum time that a message has waited for the recorder, in ns; more is a jump of the clock."""
_INFINITE = "{sec: 9223372036, nsec: 854775807}"
"""An infinite duration, as rosbag2 writes it."""


class RosRecorder:
    """Records all topics that the agent publishes, in a separate thread.

    The messages are written as the middleware delivers them, without being decoded.

    Args:
        path: path of the new file, which must not exist; see `RecordingFiles` for a split
            recording.
        on_early_end: called with the reason, in the recorder's thread, if the recording ends before
            `close`, and in the thread that calls `close` if that fails.
        now: returns the Unix time in ns, by a monotonic clock.

    Attributes:
        files: the files; open until `close`.
        lost: number of messages that the middleware reports as lost, by topic. Losses on a latched
            topic before its first message do not count.

    Raises:
        OSError: the file cannot be created.
        Exception: the namespace is invalid; the type is rclpy's.
    """

    def __init__(
        self,
        namespace: str,
        path: Path,
        limits: Limits,
        on_early_end: Callable[[str], None],
        now: Callable[[], int],
    ) -> None:
        self._now = now
        self.lost: Counter[str] = Counter()
        self._thread = NodeThread(f"record_{os.getpid()}", namespace)
        self._node = self._thread.node
        try:
            self.files = RecordingFiles(path, limits, lambda _: None, on_early_end, ROS_PROFILE)
        except OSError:
            self._thread.close()
            raise
        self._channels: dict[str, Channel] = {}
        """Channels of the recorded topics, by topic."""
        self._unreadable: set[str] = set()
        """Topics that are not recorded, because the definition of their type cannot be read."""
        self._node.create_timer(_DISCOVERY_PERIOD, self._discover)
        self._node.create_timer(_FLUSH_PERIOD, self.files.flush)
        self._thread.start(self._on_crash)

    @property
    def messages(self) -> int:
        """Number of messages in the files; complete after `close`."""
        return sum(self.files.count(topic) for topic in self._channels)

    def close(self) -> None:
        """End the thread, and complete and close the file."""
        self._thread.stop()
        self.files.close()
        self._thread.close()

    # The methods below run in the recorder's thread.

    def _on_crash(self, error: Exception) -> None:
        _LOG.error("the recording of ROS topics failed", exc_info=error)
        self.files.end_early(f"internal error: {error!r}")

    def _discover(self) -> None:
        """Subscribe to the topics that the agent has begun to publish."""
        node = self._node
        for name, namespace in find_agents(node):
            try:
                published = node.get_publisher_names_and_types_by_node(name, namespace)
            except NodeNameNonExistentError:  # the node has just ended, or is not known yet
                continue
            for topic, types in published:
                is_known = topic in self._channels or topic in self._unreadable
                is_hidden = any(part.startswith("_") for part in topic.split("/"))
                if not is_known and not is_hidden:
                    self._subscribe(topic, types[0])

    def _subscribe(self, topic: str, type_name: str) -> None:
        """Record a topic; `type_name` is the name of its type, e.g. `nav_msgs/msg/Odometry`."""
        short = type_name.replace("/msg/", "/")
        offered = self._node.get_publishers_info_by_topic(topic)
        if not offered:  # the topic was found before its publisher: `_discover` tries again
            return
        try:
            schema = definition(short).encode()
        except ToolError as error:
            self._unreadable.add(topic)
            _LOG.warning("%s is not recorded: %s", topic, error)
            return
        profiles = [info.qos_profile for info in offered]
        channel = self._channels[topic] = Channel(
            topic,
            type_name,
            schema,
            schema_encoding="ros2msg",
            message_encoding="cdr",
            metadata={
                "offered_qos_profiles": "\n".join(map(_to_yaml, profiles)),
                "topic_type_hash": type_hash(offered[0]),
            },
        )

        profile = _fitting_all(profiles)
        # Losses on a latched topic count after its first message: the agent may replace the latched
        # message while it is being sent to the new subscription.
        counts_losses = profile.durability is not DurabilityPolicy.TRANSIENT_LOCAL

        def on_message(data: bytes, info: Mapping[str, int]) -> None:
            nonlocal counts_losses
            counts_losses = True
            received = received_at(info, self._now())
            self.files.add(channel, received, data, info.get("source_timestamp") or received)

        def on_lost(event: Any) -> None:
            if counts_losses:
                self.lost[topic] += event.total_count_change

        self._node.create_subscription(
            class_of(short),
            topic,
            on_message,
            profile,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=on_lost),
        )


def received_at(info: Mapping[str, int], now: int) -> int:
    """Return the time in ns at which a message was received.

    Args:
        info: rclpy's information about the message.
        now: current Unix time in ns, by a monotonic clock.
    """
    wall_clock = time.time_ns()
    age = wall_clock - (info.get("received_timestamp") or wall_clock)
    return now - min(max(age, 0), _MAX_AGE)


def _fitting_all(profiles: list[QoSProfile]) -> QoSProfile:
    """Return the strictest profile that all publishers of a topic satisfy."""
    reliable = all(each.reliability is ReliabilityPolicy.RELIABLE for each in profiles)
    latched = all(each.durability is DurabilityPolicy.TRANSIENT_LOCAL for each in profiles)
    return QoSProfile(
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _to_yaml(profile: QoSProfile) -> str:
    """Return a profile as rosbag2 stores it; `ros2 bag play` publishes with it."""
    return (
        "- history: keep_last\n"
        f"  depth: {profile.depth or 1}\n"
        f"  reliability: {profile.reliability.name.lower()}\n"
        f"  durability: {profile.durability.name.lower()}\n"
        f"  deadline: {_INFINITE}\n"
        f"  lifespan: {_INFINITE}\n"
        "  liveliness: automatic\n"
        f"  liveliness_lease_duration: {_INFINITE}\n"
        "  avoid_ros_namespace_conventions: false"
    )
