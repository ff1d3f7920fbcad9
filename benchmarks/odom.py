"""Measure how far odom is from the pose of the simulated robot, between its reports too.

scripts/bench --odom                            drive for 33 s and print the figures
scripts/bench --odom --picture docs/odom.svg    also draw the beginning of the drive

The robot reports its pose as often as the profile of the simulator says, every 0.204 s by default.
Two agents follow it: one predicts odom between the reports, the other one does not. Each message is
compared with the pose of the robot at the stamp of the message. Only messages of a moving robot
count, because that of a standing one has no error. The picture needs matplotlib:
`.venv/bin/pip install matplotlib`.
"""

from __future__ import annotations

import math
import statistics
import threading
import time
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile

from benchmarks.figures import markdown
from benchmarks.options import make_parser, report
from tests.harness import Client
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_agent.testing import own_domain, running_agent, running_chassis, wait_until

DRIVE = (
    *((2.5, 0.5, 0.0), (1.5, 0.0, 0.0), (4.0, 0.5, 1.0), (1.5, 0.0, 0.0)),
    *((2.0, -0.5, 0.0), (2.0, -0.5, 1.0), (1.5, 0.0, 0.0)),
    *((2.0, 0.0, 1.0), (2.0, 0.0, -1.0), (1.5, 0.0, 0.0)),
    *((1.5, 0.5, 1.0), (1.5, 0.5, -1.0), (2.0, 0.5, 0.0), (2.0, -0.5, 0.0)),
    *((2.0, 0.5, 0.5), (2.0, -0.5, -0.5), (1.5, 0.0, 0.0)),
)
"""Curves, stops and reversals: duration in seconds, speed in m/s, angular speed in rad/s."""
SMOKE_DRIVE = ((1.5, 0.5, 1.0), (1.0, 0.0, 0.0))
_POSE_SPEED = "woosh.robot.PoseSpeed"
_COMMAND_PERIOD = 0.05
_PREDICTED, _REPORTED = "/predicted", "/reported"
"""Namespaces of the two agents."""
ODOM, REPORTS, LAST = "odom", "the reports themselves", "the last report"
"""Names of the motions that are compared with that of the robot."""
_SHOWN = 12.0
"""Length of the part of the drive that the picture shows, in seconds."""


class Truth:
    """The poses of the simulated robot, by Unix time."""

    def __init__(self) -> None:
        self._steps: list[tuple[float, float, Pose2D]] = []
        """Unix time, simulated time and pose of each step."""
        self.sent: dict[tuple[float, float, float], float] = {}
        """Unix time at which each pose was reported."""

    def record(self, simulator: SimulatorThread) -> None:
        """Record all steps and reports of a simulator from now on."""
        chassis = simulator.call(lambda sim: sim.chassis)
        tick = chassis.tick

        def noting_tick(seconds: float) -> None:
            tick(seconds)
            pose = chassis.base.pose
            self._steps.append((time.time(), chassis.stepped, Pose2D(pose.x, pose.y, pose.theta)))

        def note_report(frame: Outgoing) -> list[Outgoing]:
            if frame.type == _POSE_SPEED:
                pose = frame.body.pose  # type: ignore[union-attr]
                self.sent.setdefault(rounded(Pose2D.from_message(pose)), time.time())
            return [frame]  # unchanged

        simulator.call(lambda sim: setattr(sim.chassis, "tick", noting_tick))
        simulator.intercept(note_report)

    @property
    def poses(self) -> list[tuple[float, Pose2D]]:
        """Time and pose of each step, without the delays of the simulator's process."""
        start = min(unix - simulated for unix, simulated, _ in self._steps)
        return [(start + simulated, pose) for _, simulated, pose in self._steps]


class Track:
    """The motion of the robot, interpolated between the steps of the simulator."""

    def __init__(self, poses: list[tuple[float, Pose2D]]) -> None:
        self.times = [each for each, _ in poses]
        self._poses = [pose for _, pose in poses]

    def at(self, time: float) -> Pose2D:
        """Return the pose at a time."""
        before, share = self._step_at(time)
        one, other = self._poses[before], self._poses[before + 1]
        forward, left, turn = other.seen_from(one).arc
        return one * Pose2D.from_arc(share * forward, share * left, share * turn)

    def moves(self, time: float) -> bool:
        """Return True if the robot moves at a time."""
        before, _ = self._step_at(time)
        return self._poses[before] != self._poses[before + 1]

    def _step_at(self, time: float) -> tuple[int, float]:
        """Return the index of the last step before a time, and the elapsed share of that step."""
        before = min(max(bisect_right(self.times, time) - 1, 0), len(self.times) - 2)
        start, end = self.times[before : before + 2]
        return before, (time - start) / (end - start)


@dataclass
class Errors:
    """Differences from the true pose.

    Attributes:
        stamps: stamps of the messages, as Unix time in seconds.
        position: distance from the true position, in metres.
        heading: difference from the true heading, in radians.
    """

    stamps: list[float] = field(default_factory=list)
    position: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)

    def add(self, stamp: float, pose: Pose2D, true: Pose2D) -> None:
        """Add a message."""
        off = pose.seen_from(true)
        self.stamps.append(stamp)
        self.position.append(off.distance)
        self.heading.append(abs(off.theta))


@dataclass
class Drive:
    """The results of one drive.

    Attributes:
        truth: the motion of the robot.
        predicted: stamps and poses of odom with prediction.
        reported: stamps and poses of odom without it: of the reports.
        errors: errors of each of them, and of the last report at the stamps of odom.
        delays: delays of the stamps of the reports, in seconds.
    """

    truth: Track
    predicted: list[tuple[float, Pose2D]]
    reported: list[tuple[float, Pose2D]]
    errors: dict[str, Errors]
    delays: list[float]


def drive(steps: Sequence[tuple[float, float, float]], profile: str) -> Drive:
    """Let a simulated robot drive, and compare odom with its pose."""
    with (
        own_domain() as domain,
        running_chassis(speed=1, profile=profile) as chassis,
        ExitStack() as stack,
    ):
        for namespace, prediction in ((_PREDICTED, True), (_REPORTED, False)):
            stack.enter_context(
                running_agent(
                    chassis,
                    process=True,
                    domain=domain,
                    namespace=namespace,
                    odom_prediction=prediction,
                )
            )
        pose = chassis.state.pose
        start = Pose2D(pose.x, pose.y, pose.theta)
        truth = Truth()
        client = Client(domain)
        stack.callback(client.close)
        qos = QoSProfile(depth=10_000)
        odoms = {
            name: client.echo_with(Odometry, f"{name}/odom", qos)
            for name in (_PREDICTED, _REPORTED)
        }
        for odom in odoms.values():
            odom.wait_count(1)
        truth.record(chassis)
        with commanding(client) as command:
            for seconds, linear, angular in steps:
                command(linear, angular)
                time.sleep(seconds)
        wait_until(lambda: not chassis.call(lambda sim: sim.chassis.base.moving), "a standstill")
        for odom in odoms.values():
            odom.wait_count(len(odom.messages) + 20)
        assert not chassis.call(lambda sim: sim.chassis.base.blocked), "the robot hit a wall"
        track = Track(truth.poses)
        predicted, reported = (
            [(stamp(m), start * planar_pose(m)) for m in odoms[name].messages]
            for name in (_PREDICTED, _REPORTED)
        )
        return compare(track, predicted, reported, truth.sent)


@contextmanager
def commanding(client: Client) -> Iterator[Any]:
    """Publish velocities at 20 Hz; yield a function that sets the velocity."""
    publisher = client.node.create_publisher(Twist, f"{_REPORTED}/cmd_vel", 1)
    wait_until(publisher.get_subscription_count, "the agent")
    message, stopping = Twist(), threading.Event()

    def command(linear: float, angular: float) -> None:
        message.linear.x, message.angular.z = linear, angular

    def publish() -> None:
        while not stopping.wait(_COMMAND_PERIOD):
            publisher.publish(message)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield command
    finally:
        command(0.0, 0.0)
        publisher.publish(message)
        stopping.set()
        thread.join()


def compare(
    truth: Track,
    predicted: list[tuple[float, Pose2D]],
    reported: list[tuple[float, Pose2D]],
    sent: dict[tuple[float, float, float], float],
) -> Drive:
    """Return the errors of all messages while the robot moved."""
    errors = {name: Errors() for name in (ODOM, REPORTS, LAST)}
    for name, poses in ((ODOM, predicted), (REPORTS, reported)):
        for time_, pose in poses:
            if truth.moves(time_):
                errors[name].add(time_, pose, truth.at(time_))
    times = [time_ for time_, _ in reported]
    for time_ in errors[ODOM].stamps:
        latest = bisect_right(times, time_) - 1
        errors[LAST].add(time_, reported[max(latest, 0)][1], truth.at(time_))
    delays = [
        time_ - sent[rounded(pose)]
        for time_, pose in reported
        if rounded(pose) in sent and truth.moves(time_)
    ]
    return Drive(truth, predicted, reported, errors, delays)


def rounded(pose: Pose2D) -> tuple[float, float, float]:
    """Return a key by which a pose is found again after its conversions."""
    return round(pose.x, 4), round(pose.y, 4), round(pose.theta, 4)


def stamp(message: Any) -> float:
    """Return the time of a stamped message, in seconds."""
    return float(message.header.stamp.sec) + message.header.stamp.nanosec / 1e9


def planar_pose(message: Odometry) -> Pose2D:
    """Return the pose in a message."""
    position, rotation = message.pose.pose.position, message.pose.pose.orientation
    return Pose2D(position.x, position.y, 2 * math.atan2(rotation.z, rotation.w))


def quantile(values: Sequence[float], share: float) -> float:
    """Return the value that this share of all values does not exceed."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else math.nan


def figures(result: Drive) -> dict[str, dict[str, float]]:
    """Return all figures, in mm, mrad and ms."""
    found = {
        name: {
            "messages": float(len(errors.stamps)),
            "position_median": quantile(errors.position, 0.5) * 1e3,
            "position_99": quantile(errors.position, 0.99) * 1e3,
            "heading_median": quantile(errors.heading, 0.5) * 1e3,
            "heading_99": quantile(errors.heading, 0.99) * 1e3,
        }
        for name, errors in result.errors.items()
    }
    gaps = [other - one for (one, _), (other, _) in pairwise(result.predicted)]
    found["times"] = {
        "interval_median": statistics.median(gaps) * 1e3,
        "interval_99": quantile(gaps, 0.99) * 1e3,
        "stamp_delay_median": quantile(result.delays, 0.5) * 1e3,
        "stamp_delay_99": quantile(result.delays, 0.99) * 1e3,
    }
    return found


def table(found: dict[str, dict[str, float]]) -> str:
    """Return the figures as Markdown."""
    labels = {
        ODOM: "odom, at 20 Hz",
        REPORTS: "the reports, each at its own stamp",
        LAST: "the last report, at 20 Hz",
    }
    rows = [
        (
            label,
            f"{found[name]['messages']:.0f}",
            f"{found[name]['position_median']:.1f} mm",
            f"{found[name]['position_99']:.1f} mm",
            f"{found[name]['heading_median']:.1f} mrad",
            f"{found[name]['heading_99']:.1f} mrad",
        )
        for name, label in labels.items()
    ]
    header = ("", "messages", "position, median", "99 %", "heading, median", "99 %")
    return markdown(header, rows, "lrrrrr") + (
        "\n\nInterval between messages: median {interval_median:.1f} ms, "
        "99 % {interval_99:.1f} ms. Delay of the stamp of a report: "
        "median {stamp_delay_median:.1f} ms, 99 % {stamp_delay_99:.1f} ms.".format(**found["times"])
    )


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the figures."""
    parser = make_parser("odom", __doc__)
    parser.add_argument("--picture", type=Path, metavar="FILE", help="SVG file to write")
    parser.add_argument(
        "--profile", default="tr200", help="profile of the simulated robot (default tr200)"
    )
    given = parser.parse_args(arguments)
    result = drive(SMOKE_DRIVE if given.smoke else DRIVE, given.profile)
    if given.picture:
        draw(given.picture, result)
    return report(given, figures(result), table)


def draw(path: Path, drive: Drive) -> None:
    """Write a picture with two panels: the driven path, and the error over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    # with a fixed salt, the same figures give the same file
    matplotlib.rcParams["svg.hashsalt"] = path.name
    odom, last = drive.errors[ODOM], drive.errors[LAST]
    start = odom.stamps[0] - 0.2
    end = start + _SHOWN

    def shown(poses: list[tuple[float, Pose2D]]) -> list[Pose2D]:
        return [pose for time, pose in poses if start <= time <= end]

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2))
    true = [drive.truth.at(time) for time in drive.truth.times if start <= time <= end]
    left.plot([p.x for p in true], [p.y for p in true], color="0.7", linewidth=4, label="robot")
    predicted, reported = shown(drive.predicted), shown(drive.reported)
    left.plot([p.x for p in predicted], [p.y for p in predicted], ".", markersize=3, label="odom")
    left.plot(
        [p.x for p in reported], [p.y for p in reported], "o", fillstyle="none", label="reports"
    )
    left.set(xlabel="x in map, m", ylabel="y in map, m", aspect="equal")
    left.legend()
    for errors, label, style in ((last, "last report", "0.7"), (odom, "odom", "C0")):
        points = [
            (time - start, 1000 * each)
            for time, each in zip(errors.stamps, errors.position, strict=True)
            if time <= end
        ]
        right.plot(*zip(*points, strict=True), ".-", markersize=3, color=style, label=label)
    right.set(xlabel="time, s", ylabel="distance from the robot, mm")
    right.grid(visible=True, color="0.9")
    right.legend()
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
