"""Description of the machine and the versions that results were measured with."""

from __future__ import annotations

import contextlib
import os
import platform
from importlib import metadata
from pathlib import Path

import google.protobuf
import websockets.version
from ament_index_python.packages import get_package_prefix

from woosh_robot_agent.link.codecs.json_text import ORJSON


def describe_machine() -> str:
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
