"""Deployment: marks that are collected for a map."""

from __future__ import annotations

from typing import Any

import pytest

from tests.simulator.mapping import DEPLOYMENT, SWITCH_WORK_MODE, save_map, start_mapping
from tests.simulator.recorded_chassis import SteppedChassis, ask
from tests.simulator.sim_wire import Json

PLACE = {"x": 2.0, "y": -6.0, "theta": 0.5}


@pytest.fixture
def chassis(quick: SteppedChassis) -> SteppedChassis:
    ask(quick, SWITCH_WORK_MODE, mode=1)
    return quick


def collect(chassis: SteppedChassis, **body: Any) -> Json:
    return ask(chassis, DEPLOYMENT, type=4, mode=1, **body).body


def mark_info(chassis: SteppedChassis) -> Json:
    """Return the marks of the current map, as clients read them."""
    scene = ask(chassis, "woosh.robot.Scene").body
    maps = ask(chassis, "woosh.map.SceneData", name=scene["sceneName"]).body["maps"]
    found: Json = next(each for each in maps if each["name"] == scene["mapName"])["markInfo"]
    return found


def test_mark_is_collected_at_the_pose_of_the_robot_or_at_a_given_one(
    chassis: SteppedChassis,
) -> None:
    pose = chassis.chassis.base.pose
    here = {"x": pose.x, "y": pose.y, "theta": pose.theta}
    for given, expected in (({}, here), ({"pose": PLACE}, PLACE)):
        before = mark_info(chassis)
        body = collect(chassis, **given)
        (marker,) = body["markers"]
        assert marker["pose"] == pytest.approx(expected)
        info = mark_info(chassis)
        assert len(info["storages"]) == len(before["storages"]) + 1
        identity = info["storages"][-1]["identity"]
        assert str(identity["id"]) == identity["no"] == marker["id"]
        assert int(info["version"]) == int(before["version"]) + 1


def test_id_of_a_collected_mark_is_not_the_number_of_another(chassis: SteppedChassis) -> None:
    mark = mark_info(chassis)["storages"][0]
    mark["identity"] = {"no": "500"}
    ask(chassis, "woosh.map.mark.storage.Create", storage=mark)
    (marker,) = collect(chassis)["markers"]
    assert marker["id"] == "501"


def test_mark_collected_while_mapping_goes_into_the_new_map(chassis: SteppedChassis) -> None:
    before = mark_info(chassis)
    start_mapping(chassis)
    collect(chassis)
    collect(chassis, pose={"x": 50.0, "y": 0.0})  # not seen yet
    assert mark_info(chassis) == before
    save_map(chassis)
    assert [each["identity"]["no"] for each in mark_info(chassis)["storages"]] == ["1", "2"]
    (old,) = ask(chassis, "woosh.map.SceneData", name="wooshmap").body["maps"]
    assert old["markInfo"] == before
