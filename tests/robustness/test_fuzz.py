"""Codecs, client and simulator survive malformed input; `scripts/bench --fuzz` sends much more."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import math
from typing import Any

import pytest
from rich.console import Console

from benchmarks.robustness.fuzz import fuzz
from benchmarks.robustness.fuzz_targets import ACCEPTED, TARGETS, Target
from tests.convert.random_messages import extremes
from tests.link.link_peer import TIMEOUT, Peer, Wire, eventually, turns
from woosh_robot_agent.link.codecs.json_codec import from_json
from woosh_robot_agent.link.frames import FieldError
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.tools.dashboard.control import Control, ControlConfig
from woosh_robot_agent.tools.dashboard.part_data import card_data, place_data
from woosh_robot_agent.tools.dashboard.parts import Parts
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.doctor.checks import (
    check_codes,
    check_initialisation,
    check_localisation,
    check_mode,
)
from woosh_robot_agent.tools.monitor.screen import draw
from woosh_robot_agent.tools.robot_view import link_report
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.robot.status import factsheet, robot_status

SEED = 1
PUSHED = (
    "woosh.ros.Feedbacks",
    "woosh.device.RfRemoteController",
    *(f"woosh.robot.{name}" for name in ("NavPath", "PoseSpeed", "RobotState", "TaskProc")),
    "woosh.robot.count.StatusCode",
)
"""Pushes that RobotInfo does not contain, or that the dashboard also takes by themselves."""


@pytest.mark.parametrize(
    ("key", "count"),
    [
        ("json", 2000),
        ("protobuf", 2000),
        ("framing", 1000),
        ("json-client", 500),
        ("tcp-client", 500),
    ],
)
def test_no_input_breaks_the_target(key: str, count: int) -> None:
    result = fuzz(key, count, SEED)
    assert not result.crashes, result.crashes[0]
    assert result.inputs == count
    assert result.kinds[ACCEPTED] > count / 10, "most inputs are noise"
    assert result.kinds.total() - result.kinds[ACCEPTED] > count / 20


@pytest.mark.parametrize(("key", "count"), [("requests", 500), ("raw", 250)])
def test_simulator_serves_the_next_client_after_any_input(key: str, count: int) -> None:
    result = fuzz(key, count, SEED)
    assert not result.crashes, result.crashes[0]
    assert result.inputs == count
    if key == "requests":
        assert result.kinds[ACCEPTED] > count / 10
        assert result.kinds["refused with a text"] > count / 20


def test_crash_is_reported_with_the_command_that_repeats_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    feed = TARGETS["json"].feed

    def broken(target: Target, batch: list[object]) -> object:
        if len(batch[0]) % 7 == 0:  # type: ignore[arg-type]
            raise ZeroDivisionError
        return feed(target, batch)

    monkeypatch.setattr(TARGETS["json"], "feed", broken)
    result = fuzz("json", 100, SEED)
    assert 0 < len(result.crashes) < 100
    assert "ZeroDivisionError" in result.crashes[0]
    assert f"--target json --seed {SEED} --first " in result.crashes[0]
    assert "input " in result.crashes[0]


def _strict_json(text: str) -> Any:
    """Return the value of a JSON text, which must have no NaN and no infinity."""
    return json.loads(text, parse_constant=pytest.fail)


async def test_no_extreme_value_stops_a_program_that_shows_the_robot(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The dashboard receives it from a chassis, and the other programs show what it knows."""
    scans = [*extremes("woosh.robot.ScannerData")]
    scans += [{"rangeMin": -3e38, "ranges": [-5.0]}, {"rangeMax": math.inf, "ranges": [1e9]}]
    unsent = iter(scans)

    async def answer(wire: Wire, frame: Any) -> bool:
        if frame["type"] == "woosh.robot.ScannerData":
            await wire.answer(frame, next(unsent, {}))
        return frame["type"] == "woosh.robot.ScannerData"

    async with Peer(script=answer) as peer:
        shared = Parts()
        shown = Robot(peer.config(), shared, control=True, scan_rate=200.0)
        Control(shown, ControlConfig())
        shown.start()
        shown.parts.watch(object(), lambda names: None)
        wire = await peer.wire()
        await shown.chassis.wait_ready(TIMEOUT)
        for name in PUSHED:
            for body in extremes(name):
                received = shown.chassis.stats.rx
                await wire.push(name, body)
                await eventually(lambda received=received: shown.chassis.stats.rx > received)
                await turns()
                _show(shown)
        await eventually(lambda: next(unsent, None) is None)
        await turns()
        assert "no longer shows" not in caplog.text
        await shown.close()
    for body in extremes("woosh.robot.RobotInfo"):
        info = RobotInfo()
        with contextlib.suppress(FieldError):
            from_json(body, info)
        shown.view.update(info)
        _show(shown)
        # takes ten times as long as everything else
        Console(file=io.StringIO()).print(draw("it", link_report(shown.chassis), shown.view))


def _show(shown: Robot) -> None:
    """Show the state of a robot in all ways."""
    names = ("pose", "robot", "outline", "path", "codes", "map", "link", "details", "sample")
    shown.parts.publish(*names, "tasks", "control")
    json.dumps(card_data(shown.view, shown.chassis, 0), allow_nan=False)
    json.dumps(place_data(shown.view.info, 0), allow_nan=False)
    for part in shown.parts.messages.values():
        if isinstance(part, str):
            _strict_json(part)
    draw("it", link_report(shown.chassis), shown.view)
    info = shown.view.info
    for check in (check_mode, check_initialisation, check_localisation, check_codes):
        assert check(info).status
    for vehicle in (robot_status(info), factsheet(info, Limits(), ())):
        json.dumps(dataclasses.asdict(vehicle), default=str, allow_nan=False)
