"""`monitor --ip` against the simulated chassis."""

from __future__ import annotations

import io
import os
import pty
import re
import select
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
from rich.console import Console

from tests.tools.programs import HOSTILE, TIMEOUT, address, end, harmless, start
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode, StatusCodes
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    General,
    Mode,
    OperationState,
    PoseSpeed,
    RobotInfo,
    RobotState,
    Scene,
    TaskProc,
)
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.monitor.program import main
from woosh_robot_agent.tools.monitor.screen import draw
from woosh_robot_agent.tools.robot_view import LinkReport, RobotView

GOOD = LinkReport(True, "connected")


def shown(view: RobotView, link: LinkReport = GOOD) -> str:
    console = Console(file=io.StringIO(), width=200, color_system=None)
    console.print(draw("ws://x", link, view))
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return text


def row(text: str, title: str) -> str:
    """Return the text in the row with this title."""
    (found,) = re.findall(rf"^│ {re.escape(title)}  +(.*?) *│$", text, re.MULTILINE)
    return str(found)


def seen(*messages: Any) -> RobotView:
    view = RobotView()
    for message in messages:
        view.update(message)
    return view


# The drawn view


def test_an_empty_view_shows_the_link_only():
    text = shown(RobotView(), LinkReport(False, "not connected", "switch it on"))
    assert "not connected  switch it on" in row(text, "link")
    assert "mode" not in text


def test_missing_values_are_shown_as_unknown():
    text = shown(seen(RobotState(state=robot.kIdle)))
    for title in ("new task", "pose", "speed", "battery"):
        assert row(text, title) == "unknown"
    assert row(text, "mode") == "state idle"


def test_parts_update_robot_info():
    view = seen(
        PoseSpeed(pose=Pose2D(x=1.5, y=-2.25, theta=1.5708), mileage=12),
        Battery(power=15, charge_state=Battery.kNot),
        RobotInfo(battery=Battery(power=80)),
        Mode(ctrl=robot.kAuto, work=robot.kTaskMode),
        OperationState(robot=OperationState.kTaskable),
        RobotState(state=robot.kTask),
        Battery(power=14, charge_state=Battery.kAuto),
    )
    text = shown(view)
    assert row(text, "mode") == "control auto   work task   state task"
    assert row(text, "battery") == "14 %   charging (auto)"
    assert row(text, "pose") == "unknown"  # the new RobotInfo has no pose


def test_a_robot_cannot_fill_the_screen_with_names_of_actions():
    view = seen(*(ros_pack_pb2.Feedback(action=f"a.{number}") for number in range(1000)))
    assert len(view.actions) < 100
    assert "999" in view.actions


def test_an_action_may_have_ended_during_a_lost_link():
    report = ros_pack_pb2.Feedback(action="a.StepControl", state=ros_pack_pb2.kRosExecuting)
    # the topic is latched: the report may come before the answer
    assert seen(report, RobotInfo()).actions
    assert not seen(RobotInfo(), report, RobotInfo()).actions


def test_pose_task_and_actions_are_shown():
    view = seen(
        PoseSpeed(pose=Pose2D(x=1.5, y=-2.25, theta=1.5708), mileage=12),
        TaskProc(
            robot_task_id=7,
            type=task.kPick,
            state=task.kExecuting,
            dest="A2",
            msg="on the way",
            action=TaskProc.Action(type=action.kNav, state=action.kRosExecuting),
        ),
        ros_pack_pb2.Feedbacks(
            fbs=[
                ros_pack_pb2.Feedback(
                    action="woosh.ros.action.StepControl",
                    state=ros_pack_pb2.kRosExecuting,
                    msg="step 1",
                )
            ]
        ),
    )
    text = shown(view)
    assert row(text, "pose") == "x 1.500 m   y -2.250 m   theta 1.571 rad (90.0°)"
    assert row(text, "task") == "7 pick to A2   executing   on the way"
    assert row(text, "action") == "nav   executing"
    assert row(text, "StepControl") == "executing   step 1"


def test_unresolved_problems_are_shown():
    codes = [StatusCode(code=110201000013), StatusCode(code=110301000042, msg="左电机过热")]
    text = shown(seen(AbnormalCodes(scs=codes)))
    assert row(text, "problems") == "110201000013: emergency stop 1 was pressed"
    assert "110301000042: 左电机过热 (left motor is too hot)" in text
    assert row(text, "codes") == "none"
    assert row(shown(seen(AbnormalCodes())), "problems") == "none"
    assert row(shown(seen(Mode())), "problems") == "unknown"


def test_a_pose_without_a_map_is_marked():
    assert "may mean nothing" in shown(seen(PoseSpeed(pose=Pose2D(x=1.0))))
    assert "may mean nothing" not in shown(seen(PoseSpeed(pose=Pose2D(x=1.0), map_id=3)))


def test_status_codes_are_shown_newest_first_without_duplicates():
    codes = [StatusCode(code=n, time=n * 1000, msg=f"no. {n}") for n in range(1, 80)]
    view = seen(*codes[:60], RobotInfo(status_codes=StatusCodes(scs=codes[50:70])), *codes[65:])
    assert [code.code for code in view.codes.values()] == list(range(30, 80))
    text = shown(view)
    assert [int(n) for n in re.findall(r"no\. (\d+)", text)] == list(range(79, 71, -1))


def test_status_codes_after_a_jump_of_the_clock_are_the_newest():
    codes = [StatusCode(code=n, time=10_000 + n) for n in range(50)]
    view = seen(RobotInfo(status_codes=StatusCodes(scs=codes)), StatusCode(code=77, time=5))
    assert [code.code for code in view.codes.values()] == [*range(1, 50), 77]
    codes = [*codes[-3:], StatusCode(code=77, time=5), StatusCode(code=78, time=6)]
    view.update(RobotInfo(status_codes=StatusCodes(scs=codes)))  # after a reconnect
    assert [code.code for code in view.codes.values()] == [*range(2, 50), 77, 78]


def test_texts_of_the_robot_cannot_control_the_terminal():
    view = seen(
        TaskProc(state=task.kFailed, dest=HOSTILE, msg=f"{HOSTILE} [red]x[/red]"),
        General(display_model=HOSTILE),
        Scene(scene_name=HOSTILE, map_name=HOSTILE),
        PoseSpeed(pose=Pose2D(x=1.0)),
        StatusCode(code=1, msg=HOSTILE),
        AbnormalCodes(scs=[StatusCode(code=2, msg=HOSTILE)]),
        ros_pack_pb2.Feedback(action=f"a.{HOSTILE}", code=3, msg=HOSTILE),
    )
    text = shown(view, LinkReport(False, HOSTILE, HOSTILE))
    assert harmless(text)
    assert text.count("owned") >= 11
    assert "[red]x[/red]" in text


# The program


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("COLUMNS", "200"), ("LINES", "40"), ("TERM", "xterm")):
        monkeypatch.setenv(name, value)


def test_once_prints_the_state(chassis, capsys):
    where = ["--ip", f"127.0.0.1:{chassis.tcp_port}", "--transport", "tcp"]
    assert main([*where, "--once", "--timeout", "60"]) == 0
    text, err = capsys.readouterr()
    truth = chassis.state
    assert err == ""
    assert row(text, "link").startswith("connected since")
    assert row(text, "new task") == "would be accepted"
    assert row(text, "mode") == "control auto   work task   state idle"
    assert row(text, "battery") == f"{truth.info.battery.power} %"
    pose = f"x {truth.pose.x:.3f} m   y {truth.pose.y:.3f} m   theta {truth.pose.theta:.3f} rad"
    assert row(text, "pose").startswith(pose)
    assert row(text, "robot").startswith("30001  Robase200")
    assert set(chassis.counts) == {"woosh.Subscription", "woosh.robot.RobotInfo"}


class Terminal:
    """`monitor` on a pseudo-terminal."""

    def __init__(self, process: Any, master: int) -> None:
        os.set_blocking(master, False)
        self.process = process
        self._master = master
        self.text = ""

    def press(self, key: str) -> None:
        os.write(self._master, key.encode())

    def read(self) -> None:
        select.select([self._master], [], [], 0.1)
        with suppress(BlockingIOError, OSError):  # OSError: the program has ended
            self.text += os.read(self._master, 1_000_000).decode(errors="replace")

    def wait(self, text: str) -> None:
        """Wait for a text in the output after all texts found so far."""
        deadline = time.monotonic() + TIMEOUT
        while text not in self.text:
            assert time.monotonic() < deadline, f"no {text!r} in {self.text[-3000:]}"
            self.read()
        self.text = self.text.partition(text)[2]

    def wait_end(self) -> int:
        """Return the exit status. Reads the output meanwhile, so that the program can write."""
        deadline = time.monotonic() + TIMEOUT
        while self.process.poll() is None:
            assert time.monotonic() < deadline, "it does not end"
            self.read()
        self.read()
        return int(self.process.returncode)


@pytest.fixture
def terminal(chassis: SimulatorThread) -> Iterator[Terminal]:
    master, slave = pty.openpty()
    ends = {"stdin": slave, "stdout": slave, "stderr": slave}
    with start("monitor", *address(chassis), **ends) as process:
        os.close(slave)
        yield Terminal(process, master)
    os.close(master)


def test_terminal_follows_the_robot_and_its_link_until_q(terminal, chassis):
    terminal.wait("connected since")
    terminal.wait("q quits")
    chassis.set_emergency_stop(True)
    terminal.wait("the emergency stop is pressed")
    terminal.wait("release")
    chassis.stop_listening()
    terminal.wait("connection lost since")
    terminal.wait("OUTDATED")
    chassis.listen()
    terminal.wait("connected since")
    for other in "xyz0 \r\x1b[A":  # keys that do nothing
        terminal.press(other)
    terminal.wait("would be rejected")
    assert set(chassis.counts) == {"woosh.Subscription", "woosh.robot.RobotInfo"}
    terminal.press("q")
    assert terminal.wait_end() == 0
    assert "Traceback" not in terminal.text


def test_without_a_terminal_the_view_is_printed_repeatedly(chassis):
    with start("monitor", *address(chassis)) as process:
        pictures = 0
        while pictures < 3:
            pictures += "would be accepted" in process.stdout.readline()
        status, _, err = end(process)
    assert (status, err) == (0, "")
