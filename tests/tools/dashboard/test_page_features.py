"""What the page can ask and set: ways, history, speed limit, maps, fleet; and who may do so."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path

import pytest

from tests.asynchronous import TIMEOUT, eventually
from tests.tools.dashboard.pages import (
    controlled,
    dashboard,
    fetch,
    last,
    page,
    place,
    velocities,
)
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkState
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    ChangeNavMode,
    ExecTask,
    PlanNavPath,
    Twist,
)
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath, Scene
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.access import Role, kept_tokens
from woosh_robot_agent.tools.options import ToolError

_REAL_GROUPS = Path(__file__).parents[2] / "facts/real_scene/action_groups.json"


async def test_a_way_is_planned_without_being_driven(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        here = await viewer.until(lambda parts: parts["pose"])
        await viewer.give("plan", x=1.0, y=-6.0, theta=0.0)
        found = viewer.data[max(viewer.data)]
        assert math.dist(found["path"][0], (here["x"], here["y"])) < 0.1
        assert math.dist(found["path"][-1], (1.0, -6.0)) < 0.1
        assert found["length"] >= math.dist((here["x"], here["y"]), (1.0, -6.0)) - 0.1
        text = await viewer.refused("plan", x=500.0, y=0.0, theta=0.0)
        assert re.fullmatch(
            r"the place may be .* outside of the map, or cut off \(the robot: .+\)", text
        )
        assert viewer.parts["control"]["owner"] is None  # looking takes no control
        assert chassis.counts[full_name(ExecTask)] == 0
        chassis.inject("lost_localisation")
        await viewer.until(lambda parts: parts["robot"]["objections"])
        chassis.refuse(full_name(PlanNavPath), "Request failed")
        reason = await viewer.refused("plan", x=1.0, y=-6.0, theta=0.0)
        assert reason == "the robot has lost its localisation (the robot: Request failed)"


async def test_the_path_of_a_task_that_runs_already_is_known(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        await viewer.give("goMark", mark="A2")
        await viewer.until(lambda parts: parts["path"])
    async with dashboard(chassis) as running, page(running) as viewer:
        await viewer.until(lambda parts: parts["path"])


async def test_no_path_is_shown_but_that_of_a_task_or_navigation_on_this_map(
    chassis: SimulatorThread,
) -> None:
    async with (
        controlled(chassis) as viewer,
        ChassisClient(config=LinkConfig("127.0.0.1", chassis.port)) as client,
    ):
        await viewer.give("goMark", mark="A2")
        await viewer.until(lambda parts: parts["path"])
        chassis.refuse(full_name(NavPath), "not now")
        chassis.push(Scene(scene_name="scenex", map_name="scenex2"))
        await viewer.until(lambda parts: parts["robot"]["task"]["running"] and not parts["path"])
        chassis.clear_faults()
        await viewer.until(lambda parts: parts["path"])
        chassis.stop_listening()
        await viewer.until(lambda parts: not parts["link"]["good"])
        assert viewer.parts["path"]
        chassis.call(lambda simulator: simulator.chassis.tasks.cancel("a restart"))
        chassis.listen()
        await viewer.until(lambda parts: parts["link"]["good"] and not parts["path"])
        await eventually(lambda: client.state is LinkState.READY)
        pose = Pose2D(x=1.0, y=-6.0)
        await client.request(CallAction(move_base=MoveBase(action=kExecute, target_pose=pose)))
        await viewer.until(lambda parts: parts["path"])
        chassis.stop_listening()
        await viewer.until(lambda parts: not parts["link"]["good"])
        chassis.call(lambda simulator: simulator.chassis.ownership.end_driving("a restart"))
        chassis.listen()
        await viewer.until(lambda parts: parts["link"]["good"] and not parts["path"])


async def test_the_history_begins_before_the_viewer(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running:
        await eventually(lambda: len(running.robots[0].samples) > 1)
        async with page(running) as viewer:
            await viewer.ready()
            await viewer.give("history")
            found = viewer.data[max(viewer.data)]
            assert len(found["samples"]) > 1
            newest = await viewer.until(lambda parts: parts["sample"][2] and parts["sample"])
            moment, speed, battery, delay, charging = newest
            assert moment >= found["samples"][0][0]
            assert (speed, battery, charging) == (0.0, 93, False)
            assert delay > 0.0


async def test_the_history_goes_on_when_the_clock_is_set(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = part_data.now
    async with dashboard(chassis) as running:
        robot = running.robots[0]
        await eventually(lambda: len(robot.samples) > 1)
        for hours in (-1, 1000):
            known = len(robot.samples)
            monkeypatch.setattr(part_data, "now", lambda hours=hours: now() + 3_600_000 * hours)
            await eventually(lambda known=known: len(robot.samples) > known + 1)
            times = [each[0] for each in robot.samples]
            steps = [after - before for before, after in itertools.pairwise(times)]
            assert 0 < min(steps) <= max(steps) < TIMEOUT


async def test_a_robot_that_hangs_has_no_speed_in_the_history(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        await viewer.give("goMark", mark="A2")
        await viewer.until(lambda parts: parts["sample"][1] > 0.2)
        chassis.inject("freeze")
        await viewer.until(lambda parts: parts["link"]["silence"])
        speeds = []
        while len(speeds) < 2:
            speeds.append((await viewer.until(lambda parts: parts.pop("sample", None)))[1])
        assert viewer.parts["link"]["state"] == "connected"
        assert 0.0 not in speeds
        assert speeds[-1] is None


async def test_a_speed_limit_holds_for_tasks_and_for_the_stick(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        await viewer.give("speedLimit", limit=0.2)
        await viewer.until(lambda parts: parts["control"]["speedLimit"] == 0.2)
        assert viewer.parts["control"]["limits"]["linear"] == 0.2
        assert chassis.counts[full_name(ChangeNavMode)] == 0  # nothing navigates
        await viewer.give("goMark", mark="A2")
        await eventually(lambda: last(chassis, ChangeNavMode))
        assert last(chassis, ChangeNavMode).nav_mode.max_speed == pytest.approx(0.2)
        await viewer.until(lambda parts: parts["pose"]["linear"] > 0.15)
        assert viewer.parts["pose"]["linear"] <= 0.21
        await viewer.give("speedLimit", limit=None)
        await eventually(lambda: last(chassis, ChangeNavMode).nav_mode.max_speed == 0.0)
        chassis.refuse(full_name(ChangeNavMode), "not today")
        await viewer.give("speedLimit", limit=0.1)
        await viewer.until(lambda parts: parts["control"]["speedRefusal"] == "not today")
        refused = chassis.counts[full_name(ChangeNavMode)]
        await viewer.give("speedLimit", limit=None)
        await eventually(lambda: chassis.counts[full_name(ChangeNavMode)] > refused)
        await viewer.give("sound", mute=True, volume=5)  # the refusal comes before its answer
        await viewer.until(lambda parts: parts["robot"]["sound"]["volume"] == 5)
        assert viewer.parts["control"]["speedRefusal"] == ""
        await viewer.give("speedLimit", limit=0.1)
        await viewer.give("cancel")
        async with viewer.holds(5.0):
            await eventually(lambda: any(each.linear for each in velocities(chassis)))
        assert max(each.linear for each in velocities(chassis)) == pytest.approx(0.1)


async def test_all_robots_of_a_scene_are_on_the_map_and_have_a_card(
    chassis: SimulatorThread, other: SimulatorThread
) -> None:
    async with dashboard(chassis, other) as running, page(running) as viewer:
        places = await viewer.until(lambda parts: len(parts["places"]) == 2 and parts["places"])
        assert [each["index"] for each in places] == [0, 1]
        assert {each["map"] for each in places} == {"wooshmap"}
        assert len(places[1]["outline"]) > 2
        await viewer.until(lambda parts: all(each["known"] for each in parts["fleet"]))
        assert [each["id"] for each in viewer.parts["fleet"]] == [30001, 8]
        other.set_emergency_stop(True)
        name = "emergency_stop"
        await viewer.until(lambda parts: parts["fleet"][1]["objection"]["name"] == name)
        other.stop_listening()
        await viewer.until(lambda parts: parts["fleet"][1]["link"] == "lost")
        await viewer.until(lambda parts: [each["index"] for each in parts["places"]] == [0])
        # a frozen robot is noticed though nobody watches it
        other.listen()
        await viewer.until(lambda parts: parts["fleet"][1]["link"] == "connected")
        await viewer.until(lambda parts: len(parts["places"]) == 2)
        other.inject("freeze")
        await viewer.until(lambda parts: parts["fleet"][1]["silence"] > 0)
        await viewer.until(lambda parts: len(parts["places"]) == 1)


async def test_a_card_that_cannot_be_made_is_logged_and_not_shown_as_live(
    chassis: SimulatorThread, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> None:
        raise RuntimeError("there is no order")

    async with dashboard(chassis) as running, page(running) as viewer:
        await viewer.ready()
        running.robots[0].order = fail
        await eventually(lambda: "there is no order" in caplog.text)
        await viewer.until(lambda parts: parts["link"]["state"] == "failed")


async def test_who_may_look_gives_no_command(chassis: SimulatorThread) -> None:
    async with dashboard(chassis, control=True, host="0.0.0.0") as running:
        port = place(running).rpartition(":")[2]
        cookies = {}
        for role, url in running.urls.items():
            query = url.partition("?")[2]
            headers = {"Host": f"127.0.0.1:{port}"}
            _, found, _ = await fetch(running, f"/?{query}", headers)
            cookies[role] = found["set-cookie"].partition(";")[0]
        # the cookie is of the whole browser, in which a page to control may be open
        sent = {"Host": f"127.0.0.1:{port}", "Cookie": cookies[Role.CONTROL]}
        look = running.urls[Role.LOOK].partition("?")[2]
        assert "set-cookie" not in (await fetch(running, f"/?{look}", sent))[1]
        assert running.url == running.urls[Role.CONTROL]
        local = f"http://127.0.0.1:{port}"
        async with (
            page(local, Cookie=cookies[Role.LOOK]) as looking,
            page(local, Cookie=cookies[Role.CONTROL]) as controlling,
        ):
            await looking.ready()
            await controlling.ready()
            assert looking.parts["hello"]["control"] is False
            assert controlling.parts["hello"]["control"] is True
            before = chassis.counts
            for name in ("stop", "goMark", "plan", "speedLimit", "pause"):
                ok, text = await looking.command(name, mark="A2", x=0, y=0, theta=0)
                assert (ok, "only shows" in text) == (False, True)
            await looking.give("history")
            await looking.drive(0.3)
            assert await looking.closed() == 1008
            changed = chassis.counts - before
            assert not {full_name(Twist), full_name(ExecTask)} & set(changed)
            await controlling.give("goMark", mark="A2")


def test_tokens_are_kept_in_a_file_that_only_its_owner_reads(tmp_path: Path) -> None:
    path = tmp_path / "tokens.json"
    tokens = kept_tokens(path)
    assert tokens == kept_tokens(path)
    assert len(set(tokens.values())) == len(Role)
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o644)
    with pytest.raises(ToolError, match="chmod 600"):
        kept_tokens(path)
    path.chmod(0o600)
    for content in ("", "[]", "{}", json.dumps({"look": "short", "control": "short"})):
        path.write_text(content)
        with pytest.raises(ToolError, match="delete it"):
            kept_tokens(path)
    with pytest.raises(ToolError, match="No such file"):
        kept_tokens(tmp_path / "none" / "tokens.json")


def test_zones_lanes_and_kinds_of_tasks_of_a_scene() -> None:
    area = SceneData.Map()
    zone = area.field_info.speed_limit_fields.add().nav_filed
    zone.max_speed = 0.3
    for x, y in ((0, 0), (2, 0), (2, 1), (math.nan, 1)):
        zone.vertexs.add(x=x, y=y)
    area.field_info.crossings.add().nav_filed.vertexs.add(x=1)  # no area
    area.field_info.guide_markers.add(id=1)
    area.path_info.mono_paths.add().path.add(x=1)
    lane = area.path_info.bidirect_paths.add()
    for x in (1, 2):
        lane.path.add(x=x)
    (found,) = part_data.zones_data(area)
    assert found == {
        "kind": "speed_limit_fields",
        "outline": [[0, 0], [2, 0], [2, 1]],
        "speed": pytest.approx(0.3),
    }
    assert part_data.lanes_data(area) == [[[1, 0], [2, 0]]]
    kinds = part_data.task_types_data(SceneData(action_group=_REAL_GROUPS.read_text("utf-8")))
    assert {"type": "pick", "number": 1, "name": "对接导航"} in kinds
    assert [each["number"] for each in kinds if each["type"] == "carry"] == [0, 1, 2]
    for broken in ("", "[]", "{", '{"task_type": [1]}', '{"task_type": [{"no": 1}]}', "[" * 9999):
        assert part_data.task_types_data(SceneData(action_group=broken)) == []
