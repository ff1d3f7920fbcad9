"""Plots a recording: the robot's way on its map, its last laser scan, its speed and its battery.

    python3 plot_recording.py RECORDING PICTURE

It needs only mcap, mcap-protobuf-support and matplotlib.
"""

import math
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def read(path):
    """Return times in seconds and messages, by topic."""
    found = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time / 1e9, decoded))
    return found


def laser_points(scan, robot):
    """Return x and y in the map of what the laser saw when the robot was at a pose."""
    heading = 2 * math.atan2(robot.orientation.z, robot.orientation.w)
    cos, sin = math.cos(heading), math.sin(heading)
    laser_x = robot.position.x + cos * scan.pose.position.x - sin * scan.pose.position.y
    laser_y = robot.position.y + sin * scan.pose.position.x + cos * scan.pose.position.y
    step = (scan.end_angle - scan.start_angle) / max(1, len(scan.ranges) - 1)
    beams = [
        (each, heading + scan.start_angle + step * beam)
        for beam, each in enumerate(scan.ranges)
        if math.isfinite(each)
    ]
    x = [laser_x + distance * math.cos(angle) for distance, angle in beams]
    y = [laser_y + distance * math.sin(angle) for distance, angle in beams]
    return x, y


def plot(found, path):
    """Draw what `read` returned into a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplot_mosaic(
        [["map", "speed"], ["map", "battery"]],
        figsize=(11, 5.5),
        width_ratios=(2, 1),
        layout="constrained",
    )
    plane, speed, battery = axes["map"], axes["speed"], axes["battery"]
    for _, grid in found.get("/view/map", [])[-1:]:
        corner, size = grid.pose.position, grid.cell_size
        rows = len(grid.data) // grid.row_stride
        cells = memoryview(grid.data).cast("B", (rows, grid.column_count, grid.cell_stride))
        plane.imshow(
            cells,
            origin="lower",
            extent=(
                corner.x,
                corner.x + size.x * grid.column_count,
                corner.y,
                corner.y + size.y * rows,
            ),
        )
    poses = [message.pose for _, message in found["/view/pose"]]
    plane.plot(
        [p.position.x for p in poses],
        [p.position.y for p in poses],
        linewidth=4,
        alpha=0.5,
        label="driven",
    )
    for _, planned in found.get("/view/path", []):
        x, y = ([getattr(p.position, axis) for p in planned.poses] for axis in "xy")
        plane.plot(x, y, "--", color="tab:green", linewidth=1)
    plane.plot([], [], "--", color="tab:green", label="planned")
    for time, scan in found.get("/view/scan", [])[-1:]:
        robot = min(found["/view/pose"], key=lambda each: abs(each[0] - time))[1].pose
        plane.scatter(*laser_points(scan, robot), s=2, color="tab:red", label="last scan")
    plane.plot(poses[-1].position.x, poses[-1].position.y, "o", color="tab:blue")
    plane.set(xlabel="x in map, m", ylabel="y in map, m", aspect="equal")
    plane.legend(loc="upper right")

    start, end = found["/frames"][0][0], found["/frames"][-1][0]
    reports = found.get("/chassis/robot/PoseSpeed", [])
    speed.plot([time - start for time, _ in reports], [each.twist.linear for _, each in reports])
    speed.set(ylabel="speed, m/s", xlim=(0, end - start))
    reports = found.get("/chassis/robot/Battery", [])
    if reports:
        reports.append((end, reports[-1][1]))  # the robot reports only changes
    battery.step(
        [time - start for time, _ in reports], [each.power for _, each in reports], where="post"
    )
    battery.set(xlabel="time, s", ylabel="battery, %", xlim=(0, end - start), ylim=(0, 100))
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    plot(read(sys.argv[1]), sys.argv[2])
