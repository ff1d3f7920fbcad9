"""Deployment: points that are collected for a map."""

from __future__ import annotations

from typing import Any

import pytest

from tests.simulator.mapping import (
    BUILD_MAP,
    CANCEL,
    DEPLOYMENT,
    SWITCH_MAP,
    SWITCH_WORK_MODE,
    UPDATE,
    save_map,
    start_mapping,
)
from tests.simulator.recorded_chassis import SteppedChassis, ask
from tests.simulator.sim_wire import Json

BEACONS, CODES, REFLECTORS, MARKS = 1, 2, 3, 4
COLLECT, REMOVE, CALIBRATE = 1, 2, 3
PLACE = {"x": 2.0, "y": -6.0, "theta": 0.5}
LISTS = {BEACONS: "beacons", CODES: "artags", REFLECTORS: "reflectors", MARKS: "storages"}


@pytest.fixture
def chassis(quick: SteppedChassis) -> SteppedChassis:
    ask(quick, SWITCH_WORK_MODE, mode=1)
    return quick


def deploy(chassis: SteppedChassis, **body: Any) -> Json:
    return ask(chassis, DEPLOYMENT, **body).body


def mark_info(chassis: SteppedChassis) -> Json:
    """Return the marks of the current map, as clients read them."""
    scene = ask(chassis, "woosh.robot.Scene").body
    maps = ask(chassis, "woosh.map.SceneData", name=scene["sceneName"]).body["maps"]
    found: Json = next(each for each in maps if each["name"] == scene["mapName"])["markInfo"]
    return found


def test_point_is_collected_at_the_pose_of_the_robot_or_at_a_given_one(
    chassis: SteppedChassis,
) -> None:
    pose = chassis.chassis.base.pose
    here = {"x": pose.x, "y": pose.y, "theta": pose.theta}
    for kind, name in LISTS.items():
        for given, expected in (({}, here), ({"pose": PLACE}, PLACE)):
            before = mark_info(chassis)
            body = deploy(chassis, type=kind, mode=COLLECT, **given)
            assert (body["type"], body["mode"], body["checkTimes"]) == (kind, COLLECT, 1)
            (marker,) = body["markers"]
            assert marker["pose"] == pytest.approx(expected)
            info = mark_info(chassis)
            assert len(info[name]) == len(before[name]) + 1
            identity = info[name][-1]["identity"] if kind == MARKS else info[name][-1]
            assert str(identity["id"]) == marker["id"]
            assert kind != MARKS or identity["no"] == marker["id"]
            assert int(info["version"]) == int(before["version"]) + 1


def test_cancelling_removes_what_was_collected(chassis: SteppedChassis) -> None:
    before = mark_info(chassis)
    for kind in LISTS:
        deploy(chassis, type=kind, mode=COLLECT)
    answer = deploy(chassis, type=MARKS, mode=REMOVE)
    assert (answer["mode"], answer["markers"]) == (REMOVE, [])
    after = mark_info(chassis)
    assert after["storages"] == before["storages"]
    assert [len(after[name]) for name in ("beacons", "artags", "reflectors")] == [1, 1, 1]
    deploy(chassis, mode=REMOVE)
    after = mark_info(chassis)
    assert {**after, "version": 0} == {**before, "version": 0}


def test_points_of_an_earlier_session_stay(chassis: SteppedChassis) -> None:
    for leave in (
        lambda: [ask(chassis, SWITCH_WORK_MODE, mode=mode) for mode in (2, 1)],
        lambda: [ask(chassis, SWITCH_MAP, sceneName=name) for name in ("scenex", "wooshmap")],
    ):
        deploy(chassis, type=MARKS, mode=COLLECT)
        count = len(mark_info(chassis)["storages"])
        leave()
        deploy(chassis, type=MARKS, mode=REMOVE)
        assert len(mark_info(chassis)["storages"]) == count


def test_reflectors_are_calibrated(chassis: SteppedChassis) -> None:
    for x in (1.0, 3.0):
        deploy(chassis, type=REFLECTORS, mode=COLLECT, pose={"x": x, "y": -6.0})
    answer = deploy(chassis, type=REFLECTORS, mode=CALIBRATE)
    assert [each["pose"]["x"] for each in answer["markers"]] == [1.0, 3.0]
    assert (answer["checkTimes"], answer["errorIdGroups"]) == (1, [])


def test_points_collected_while_mapping_go_into_the_new_map(chassis: SteppedChassis) -> None:
    before = mark_info(chassis)
    start_mapping(chassis)
    deploy(chassis, type=MARKS, mode=COLLECT)
    deploy(chassis, type=CODES, mode=COLLECT, pose={"x": 50.0, "y": 0.0})  # not seen yet
    assert mark_info(chassis) == before
    save_map(chassis)
    after = mark_info(chassis)
    assert [each["identity"]["no"] for each in after["storages"]] == ["1"]
    assert len(after["artags"]) == 1
    (old,) = ask(chassis, "woosh.map.SceneData", name="wooshmap").body["maps"]
    assert old["markInfo"] == before
    # They can still be cancelled.
    deploy(chassis, type=MARKS, mode=REMOVE)
    assert mark_info(chassis)["storages"] == []


def test_cancelled_update_forgets_its_points_only(chassis: SteppedChassis) -> None:
    deploy(chassis, type=MARKS, mode=COLLECT)
    count = len(mark_info(chassis)["storages"])
    start_mapping(chassis, UPDATE, "wooshmap", "wooshmap")
    deploy(chassis, type=MARKS, mode=COLLECT)
    assert len(mark_info(chassis)["storages"]) == count + 1
    ask(chassis, BUILD_MAP, type=CANCEL)
    assert len(mark_info(chassis)["storages"]) == count
