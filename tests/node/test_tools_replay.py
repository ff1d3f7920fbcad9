"""A task runs through `record`, and again with `replay`."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.harness import wait_until
from tests.node.goals import COMPLETED, SUCCEEDED, short_task
from woosh_robot_agent.tools.recording.layout import Frame
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_msgs.msg import Mode as ModeMsg
from woosh_robot_msgs.msg import TaskProc as TaskProcMsg
from woosh_robot_msgs.srv import RobotInfo, Speak

TIMEOUT = 60.0
TASK = 77


@contextmanager
def running(tool: str, *arguments: str) -> Iterator[int]:
    """Run a program and yield the port that it prints; end it with Ctrl-C."""
    process = subprocess.Popen(
        [sys.executable, "-m", "woosh_robot_agent.tools", tool, *arguments],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if found := re.search(r"(?:agent to |ready on ws://)127\.0\.0\.1:(\d+)", line):
                yield int(found[1])
                break
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=TIMEOUT)
        assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()


def do_task(client: Any) -> tuple[int, list[Any], list[Any]]:
    """Run a task; return its status, its feedback and its messages on the topic."""
    echo = client.echo(TaskProcMsg, "robot/TaskProc")
    wait_until(lambda: client.node.count_publishers(client.path("robot/TaskProc")), "the topic")
    goal = short_task(client, 0.5, task_id=TASK)
    status, ret = goal.result(TIMEOUT)
    ends = COMPLETED if status == SUCCEEDED else ret.state.value
    echo.wait(lambda m: m.robot_task_id == TASK and m.state.value == ends)
    reports = [m for m in echo.messages if m.robot_task_id == TASK]
    return status, list(goal.feedback.messages), reports


def test_a_recorded_task_is_replayed_identically(
    tmp_path: Path, simulator: Any, start_agent: Any, client: Any
) -> None:
    """It is recorded over TCP, and replayed over a WebSocket."""
    path = tmp_path / "field.mcap"
    there = ["--ip", f"127.0.0.1:{simulator.tcp_port}", "--transport", "tcp"]
    with running("record", *there, "--listen", "127.0.0.1:0", "--output", str(path)) as proxy:
        agent = start_agent(ip="127.0.0.1", port=proxy, transport="tcp", backoff_min=0.1)
        agent.wait_connected()
        info = client.call(RobotInfo, "robot/RobotInfo").info
        status, feedback, topic = do_task(client)
        assert status == SUCCEEDED
        agent.close()

    recorded = [record for record in read_recording(path).records if isinstance(record, Frame)]
    assert {record.sender for record in recorded} == {"client", "chassis"}

    arguments = ["--port", "0", "--tcp-port", "0", "--speed", "5", "--wait-for-commands"]
    with running("replay", str(path), *arguments) as replayed:
        again = start_agent(ip="127.0.0.1", port=replayed, backoff_min=0.1, encoding="protobuf")
        again.wait_connected()
        mode = client.echo(ModeMsg, "robot/Mode").wait_count(1)[0]
        assert mode == info.mode
        assert client.call(RobotInfo, "robot/RobotInfo").info == info
        assert do_task(client) == (status, feedback, topic)
        refused = client.call(Speak, "robot/Speak")
        assert not refused.ok
        assert "the recording has no request of type woosh.robot.Speak" in refused.msg
        again.close()
