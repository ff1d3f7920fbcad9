"""Plot of odom between reports. It needs matplotlib: `.venv/bin/pip install matplotlib`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

if TYPE_CHECKING:
    from benchmarks.measurements.odom import Drive
    from woosh_robot_agent.ros.standard.poses import Pose2D

_SHOWN = 12.0
"""Length of the part of the drive that is shown, in seconds."""


def draw(path: Path, drive: Drive) -> None:
    """Write an SVG with two panels: the driven path, and the error over time."""
    # with a fixed salt, the same figures give the same file
    matplotlib.rcParams["svg.hashsalt"] = path.name
    odom, last = drive.errors["odom"], drive.errors["the last report"]
    start = odom.stamps[0] - 0.2
    end = start + _SHOWN

    def shown(poses: list[tuple[float, Pose2D]]) -> list[Pose2D]:
        return [pose for time, pose in poses if start <= time <= end]

    figure, (way, error) = plt.subplots(1, 2, figsize=(10, 4.2))
    true = [drive.truth.at(time) for time in drive.truth.times if start <= time <= end]
    way.plot([p.x for p in true], [p.y for p in true], color="0.7", linewidth=4, label="robot")
    predicted, reported = shown(drive.predicted), shown(drive.reported)
    way.plot([p.x for p in predicted], [p.y for p in predicted], ".", markersize=3, label="odom")
    way.plot(
        [p.x for p in reported], [p.y for p in reported], "o", fillstyle="none", label="reports"
    )
    way.set(xlabel="x in map, m", ylabel="y in map, m", aspect="equal")
    way.legend()
    for errors, label, style in ((last, "last report", "0.7"), (odom, "odom", "C0")):
        points = [
            (time - start, 1000 * each)
            for time, each in zip(errors.stamps, errors.position, strict=True)
            if time <= end
        ]
        error.plot(*zip(*points, strict=True), ".-", markersize=3, color=style, label=label)
    error.set(xlabel="time, s", ylabel="distance from the robot, mm")
    error.grid(visible=True, color="0.9")
    error.legend()
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
