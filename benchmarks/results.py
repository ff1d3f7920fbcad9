"""Files with the results of benchmarks: `results/RELEASE/NAME.md`."""

from __future__ import annotations

import contextlib
import datetime
import io
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path

import google.protobuf
import websockets.version
from ament_index_python.packages import get_package_prefix

from benchmarks.processes import ROOT
from woosh_robot_agent.link.codecs.json_text import ORJSON

RESULTS = Path(__file__).parent / "results"


class _Tee(io.StringIO):
    """Keeps what is written to it, and also prints it."""

    def __init__(self) -> None:
        super().__init__()
        self._stdout = sys.stdout

    def write(self, text: str) -> int:
        self._stdout.write(text)
        return super().write(text)

    def flush(self) -> None:
        self._stdout.flush()


def save(
    name: str, title: str, options: Sequence[str], run: Callable[[], int], folder: Path = RESULTS
) -> int:
    """Run a benchmark, and write the tables that it prints to a file.

    Args:
        name: name of the benchmark.
        title: title of the page.
        options: options of the benchmark.
        run: runs it; returns its exit status.
        folder: folder of the results.

    Returns:
        The exit status of the benchmark.
    """
    date = datetime.datetime.now(datetime.timezone.utc).date()
    with contextlib.redirect_stdout(_Tee()) as output:
        status = run()
    command = " ".join(("scripts/bench", f"--{name}", *options))
    page = folder / os.environ.get("ROS_DISTRO", "unknown") / f"{name}.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(
        f"# {title[0].upper()}{title[1:]}\n\n"
        f"`{command}` on {date}, woosh_robot_agent {_version()}.\n\n"
        f"{_machine()}.\n\n{output.getvalue().rstrip()}\n"
    )
    print(f"wrote {page}", file=sys.stderr)
    return status


def _version() -> str:
    """Return the version of the package, and the commit."""
    found = re.search("<version>(.*)</version>", (ROOT / "package.xml").read_text())
    assert found
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    ).stdout.strip()
    return f"{found[1]} ({commit or 'not a git checkout'})"


def _machine() -> str:
    """Return the CPU and all versions that influence results, in one line."""
    return ", ".join(
        (
            f"{_cpu()} ({os.cpu_count()} cores)",
            f"Linux {platform.release()}",
            f"Python {platform.python_version()}",
            f"ROS 2 {os.environ.get('ROS_DISTRO', 'unknown').capitalize()}, rclpy {_rclpy()}",
            f"websockets {websockets.version.version}",
            f"protobuf {google.protobuf.__version__}",
            f"orjson {ORJSON.__version__}" if ORJSON else "no orjson",
        )
    )


def _cpu() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine()


def _rclpy() -> str:
    """Return the release of rclpy: that of its PyPI package, or that of its ROS package."""
    with contextlib.suppress(metadata.PackageNotFoundError):
        return metadata.version("ros-rclpy")
    manifest = Path(get_package_prefix("rclpy"), "share/rclpy/package.xml").read_text()
    return manifest.partition("<version>")[2].partition("</version>")[0]
