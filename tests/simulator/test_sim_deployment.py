"""Deployment: points that are collected for a map."""

from __future__ import annotations

from dataclasses import replace
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
from woosh_robot_agent.simulator.timeline import copy_of
from woosh_robot_agent.simulator.world.maps import Mark

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


@pytest.mark.parametrize("kind", LISTS)
def test_point_is_collected_at_the_pose_of_the_robot(chassis: SteppedChassis, kind: int) -> None:
    before = len(mark_info(chassis)[LISTS[kind]])
    body = deploy(chassis, type=kind, mode=COLLECT)
    assert (body["type"], body["mode"], body["checkTimes"]) == (kind, COLLECT, 1)
    (marker,) = body["markers"]
    pose = chassis.chassis.base.pose
    assert list(marker["pose"].values()) == pytest.approx([pose.x, pose.y, pose.theta])
    entries = mark_info(chassis)[LISTS[kind]]
    assert len(entries) == before + 1
    identity = entries[-1]["identity"] if kind == MARKS else entries[-1]
    assert str(identity["id"]) == marker["id"]


@pytest.mark.parametrize("kind", LISTS)
def test_point_is_collected_at_the_given_pose(chassis: SteppedChassis, kind: int) -> None:
    (marker,) = deploy(chassis, type=kind, mode=COLLECT, pose=PLACE)["markers"]
    assert marker["pose"] == pytest.approx(PLACE)


def test_id_of_a_mark_is_its_number(chassis: SteppedChassis) -> None:
    numbers = []
    for _ in range(2):
        (marker,) = deploy(chassis, type=MARKS, mode=COLLECT)["markers"]
        numbers.append(marker["id"])
    assert len(set(numbers)) == 2
    groups = ask(chassis, "woosh.map.SceneDataEasy").body["maps"][0]["storages"]["bases"]
    assert [each["identity"]["no"] for each in groups[-2:]] == numbers


@pytest.mark.parametrize("kind", LISTS)
def test_point_gets_a_free_id_if_another_one_has_the_greatest(
    chassis: SteppedChassis, kind: int
) -> None:
    model, greatest = chassis.chassis, 2**32 - 1
    others = copy_of(model.map.other_marks)
    for name in ("beacons", "artags", "reflectors"):
        getattr(others, name).add(id=greatest)
    marks = {**model.map.marks, "far": Mark(greatest, "far", model.base.pose)}
    taken = {mark.id for mark in marks.values()}
    model.change_map(replace(model.map, marks=marks, other_marks=others))
    (marker,) = deploy(chassis, type=kind, mode=COLLECT)["markers"]
    assert int(marker["id"]) not in (taken if kind == MARKS else {0, greatest})


def test_collecting_is_a_new_version_of_the_map(chassis: SteppedChassis) -> None:
    before = int(ask(chassis, "woosh.robot.Scene").body["version"])
    deploy(chassis, type=MARKS, mode=COLLECT)
    assert int(ask(chassis, "woosh.robot.Scene").body["version"]) == before + 1


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


def test_mark_that_was_changed_meanwhile_stays(chassis: SteppedChassis) -> None:
    (marker,) = deploy(chassis, type=MARKS, mode=COLLECT)["markers"]
    model = chassis.chassis
    marks = dict(model.map.marks)
    marks["A99"] = replace(marks.pop(marker["id"]), number="A99")
    model.change_map(replace(model.map, marks=marks))
    deploy(chassis, type=MARKS, mode=REMOVE)
    assert "A99" in model.map.marks
