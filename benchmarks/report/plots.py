"""Plots of cost over size. They need matplotlib: `.venv/bin/pip install matplotlib`."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks.report.curves import Curves, Sweep


def draw(path: Path, sweep: Sweep, curves: Curves, machine: str) -> None:
    """Write an SVG with two panels, CPU and latency, and the machine below them."""
    # with a fixed salt, the same figures give the same file
    matplotlib.rcParams["svg.hashsalt"] = path.name
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2))
    for number, (name, points) in enumerate(curves.items()):
        sizes, color = [point.size for point in points], f"C{number}"
        left.plot(sizes, [point.cpu for point in points], "o-", color=color, label=name)
        median, p99 = [p.median for p in points], [p.p99 for p in points]
        right.plot(sizes, median, "o-", color=color, label=f"{name}, median")
        right.plot(sizes, p99, ".--", color=color, label=f"{name}, p99")
    _finish_panel(left, sweep.size, sweep.cpu)
    _finish_panel(right, sweep.size, "latency, ms")
    figure.suptitle(sweep.title)
    figure.text(0.5, 0.01, textwrap.fill(machine, 120), ha="center", fontsize=8, color="0.3")
    figure.tight_layout(rect=(0, 0.07, 1, 1))
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _finish_panel(axes: Any, x_label: str, y_label: str) -> None:
    axes.set(xlabel=x_label, ylabel=y_label, xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.grid(visible=True, which="both", color="0.9")
    axes.legend()
