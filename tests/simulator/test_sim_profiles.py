"""Profiles: the files that say how a robot behaves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator import SimulatorConfig
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.command_line import make_parser
from woosh_robot_agent.simulator.profile import SHIPPED, SHIPPED_FOLDER, load_profile
from woosh_robot_agent.simulator.protocol.handlers import dispatch
from woosh_robot_agent.simulator.protocol.reports import robot_info
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.testing import running_chassis

SHIPPED_FILE = SHIPPED_FOLDER / "tr200.yaml"


@pytest.fixture
def data() -> Any:
    """The content of the profile tr200."""
    return yaml.safe_load(SHIPPED_FILE.read_text())


def write(folder: Path, data: Any) -> Path:
    file = folder / "own.yaml"
    file.write_text(yaml.safe_dump(data))
    return file


def test_the_default_is_the_real_robot() -> None:
    assert SHIPPED == ("instant", "tr200")
    assert Chassis(SimulatorConfig()).profile.name == "tr200"
    assert make_parser().parse_args([]).profile == "tr200"


def test_own_profile_is_used(tmp_path: Path, data: Any) -> None:
    data["tasks"]["first_report"] = [3.0]
    data["answers"]["requests"]["woosh.robot.Mode"] = [1.0, 1.0, 1.0]
    file = write(tmp_path, data)
    profile = Chassis(SimulatorConfig(profile=file)).profile
    assert (profile.name, profile.tasks.first_report) == ("own", (3.0,))
    assert profile.answers.requests["woosh.robot.Mode"].median == 1.0
    assert Chassis(SimulatorConfig(profile=str(file))).profile == profile
    assert Chassis(SimulatorConfig(profile=profile)).profile is profile
    with running_chassis(speed=1, profile=file) as simulator:
        assert simulator.call(lambda running: running.chassis.profile) == profile


def test_sizes_of_the_robot_are_those_of_the_profile(tmp_path: Path, data: Any) -> None:
    data["model"]["outline"] = [[0.5, 0.3], [0.5, -0.3], [-0.5, -0.3], [-0.5, 0.3]]
    data["model"]["length"] = 1000
    chassis = Chassis(SimulatorConfig(profile=write(tmp_path, data)))
    info = robot_info(chassis)
    assert info.genral.model_data.length == 1000
    corners = [(round(each.x, 3), round(each.y, 3)) for each in info.model.model]
    assert corners == [(0.5, 0.3), (0.5, -0.3), (-0.5, -0.3), (-0.5, 0.3)]
    east_wall = 12.0
    chassis.localise(Pose(10.0, 8.0, 0.0))
    for _ in range(200):
        dispatch(chassis, Twist(linear=0.5))
        chassis.tick(TIME_STEP)
    assert east_wall - 0.55 < chassis.base.pose.x < east_wall - 0.5


INVALID: list[tuple[str, str, Any, str]] = [
    ("tasks", "between_jobs", -1.0, "must be a number of at least 0"),
    ("tasks", "order_effect", [3.0, 2.0, 1.0], "must be [median, usual, longest]"),
    ("tasks", "empty_report", 1.0, "must be [least, most]"),
    ("tasks", "state_first", 1.5, "must be a number from 0.0 to 1.0"),
    ("tasks", "starting_states", ["kWarm"], "'kWarm' is not one of kInit, kReady"),
    ("answers", "requests", {"woosh.robot.Mod": [0, 0, 0]}, "no such request"),
    ("driving", "max_speed", 1e9, "must be a number from 0.01 to 10.0"),
    ("model", "outline", [[0.0, 1.0], [1.0, 0.0]], "has 2 entries, which is less than 3"),
    ("status_codes", "language", "fr", "'fr' is not one of zh, en, none"),
]
"""Section of the profile, key, invalid value, and what the error says."""


def test_invalid_value_is_named(tmp_path: Path, data: Any) -> None:
    for section, key, value, error in INVALID:
        invalid = {**data, section: {**data[section], key: value}}
        with pytest.raises(DataFileError) as found:
            load_profile(write(tmp_path, invalid))
        text = str(found.value)
        assert text.startswith(f"own.yaml: {section}"), text
        assert key in text
        assert error in text


def test_unknown_profile_names_the_shipped_ones() -> None:
    with pytest.raises(DataFileError, match=r"tr300: No such file or directory; .* instant, tr200"):
        load_profile("tr300")
