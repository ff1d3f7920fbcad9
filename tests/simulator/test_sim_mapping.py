"""Making a map: the sequence of a real robot, its times, and what may interrupt it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from itertools import pairwise
from typing import Any

import pytest

from tests.simulator.mapping import (
    ADD,
    BUILD_MAP,
    BUILD_MAP_DATA,
    CANCEL,
    DEPLOYMENT,
    DEPLOYMENT_MODE,
    INIT_ROBOT,
    SAVE,
    SCENE,
    STATE,
    SWITCH_MAP,
    SWITCH_WORK_MODE,
    TASK_MODE,
    TWIST,
    UPDATE,
    at,
    drive,
    picture,
    save_map,
    start_mapping,
    turn_around,
    use_map,
)
from tests.simulator.real_tasks import TASK_ID, exec_task, real_robot, shows, watch
from tests.simulator.recorded_chassis import (
    SCANNER_DATA,
    SteppedChassis,
    answer_to,
    ask,
    pushed,
    wait_frame,
)
from tests.simulator.sim_wire import Json, JsonClient
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.testing import wait_until

FACTS = real_robot()
TIMES, RATES = FACTS["times"], FACTS["rates"]
UNINIT, IDLE, FAULT, MAPPING = 1, 2, 6, 9
FREE = 254
SCENE_LIST = "woosh.map.SceneList"
PAUSED = 4


def states(chassis: SteppedChassis) -> list[int]:
    return [frame.body["state"] for frame in pushed(chassis, STATE)]


def scenes(chassis: SteppedChassis) -> dict[str, list[str]]:
    found = ask(chassis, SCENE_LIST).body["scenes"]
    return {scene["name"]: scene["maps"] for scene in found}


def wait_answer(chassis: SteppedChassis, type_name: str, **body: Any) -> tuple[float, float]:
    """Return the times of a request and of its answer, which must be ok."""
    sent = chassis.chassis.elapsed
    answer = ask(chassis, type_name, **body)
    return sent, answer.time


def test_map_is_made_in_the_sequence_of_the_real_robot(real: SteppedChassis) -> None:
    ask(real, SWITCH_WORK_MODE, mode=DEPLOYMENT_MODE)
    sent, answered = wait_answer(real, BUILD_MAP, type=ADD, sceneName="new", mapName="hall")
    least, most = TIMES["BuildMap that starts to its answer"]
    assert least <= answered - sent <= most
    mapping = wait_frame(real, shows(MAPPING))
    assert mapping.time - sent == pytest.approx(TIMES["BuildMap that starts to kMapping"], rel=0.1)
    turn_around(real)
    times = [frame.time for frame in pushed(real, BUILD_MAP_DATA)]
    assert times[0] - mapping.time == pytest.approx(1.0, abs=0.02)
    assert len(times) >= 9
    least, most = RATES["BuildMapData"]
    assert all(least <= after - before <= most for before, after in pairwise(times))

    real.frames.clear()
    sent, answered = wait_answer(real, BUILD_MAP, type=SAVE)
    scene, uninit = (wait_frame(real, lambda f: f.type == SCENE), wait_frame(real, shows(UNINIT)))
    assert (scene.body["sceneName"], scene.body["mapName"]) == ("new", "hall")
    assert scene.time - sent == pytest.approx(TIMES["BuildMap that saves to Scene"], abs=0.06)
    least, most = TIMES["BuildMap that saves to kUninit"]
    assert least <= uninit.time - sent <= most
    assert uninit.time == answered
    assert all(frame.time <= sent for frame in pushed(real, BUILD_MAP_DATA))

    marker = ask(real, DEPLOYMENT, type=4, mode=1).body["markers"][0]
    drive(real, (0.0, -7.0))
    use_map(real)
    assert states(real) == [UNINIT, IDLE]
    task = watch(real, lambda: exec_task(real, marker["id"]))
    assert task.triples[-1][0] == "kCompleted"
    pose = real.chassis.base.pose
    assert (pose.x, pose.y) == pytest.approx((marker["pose"]["x"], marker["pose"]["y"]), abs=0.01)


def test_picture_shows_what_the_robot_has_seen(quick: SteppedChassis) -> None:
    start_mapping(quick)
    quick.run(1.1)
    first = pushed(quick, BUILD_MAP_DATA)[-1].body
    pixels = picture(first)
    assert (first["height"], first["width"]) == pixels.shape
    assert first["resolution"] == pytest.approx(0.05)
    assert set(pixels.flat) == {0, 205, FREE}
    pose = quick.chassis.base.pose
    assert at(first, pixels, pose.x, pose.y) == FREE  # where it stands
    assert at(first, pixels, 6.0, -7.0) == FREE  # in sight
    assert at(first, pixels, 12.0, -8.0) == 0  # a wall in sight
    assert first["originX"] > -5.0  # nothing behind it yet
    turn_around(quick)
    last = pushed(quick, BUILD_MAP_DATA)[-1].body
    assert last["originX"] < first["originX"]
    assert (picture(last) == FREE).sum() > 1.2 * (pixels == FREE).sum()
    assert ask(quick, BUILD_MAP_DATA).body["width"] == last["width"]
    ask(quick, BUILD_MAP, type=CANCEL)
    assert ask(quick, BUILD_MAP_DATA).body["mapData"] == ""


def test_saved_map_is_the_current_one_in_a_scene_that_exists(quick: SteppedChassis) -> None:
    before = scenes(quick)["scenex"]
    exec_task(quick)
    ask(quick, "woosh.robot.ActionOrder", order=4)
    start_mapping(quick, scene="scenex")
    turn_around(quick)
    sent, end = quick.chassis.elapsed, quick.chassis.base.pose

    save_map(quick)
    assert quick.chassis.elapsed == sent
    assert scenes(quick)["scenex"] == [*before, "hall"]
    *others, area = ask(quick, "woosh.map.SceneData", name="scenex").body["maps"]
    assert area["id"] not in [each["id"] for each in others]
    assert (area["end"]["x"], area["end"]["y"]) == pytest.approx(end.point)
    assert ask(quick, "woosh.robot.PoseSpeed").body["mapId"] == area["id"]
    assert int(ask(quick, "woosh.robot.TaskProc").body["robotTaskId"]) == TASK_ID  # of the last one
    # The other maps of the scene can still be used.
    ask(quick, SWITCH_MAP, sceneName="scenex", mapName=before[0])


def test_nothing_remains_of_a_cancelled_map(quick: SteppedChassis) -> None:
    before = scenes(quick)
    start_mapping(quick)
    turn_around(quick)
    seen = picture(pushed(quick, BUILD_MAP_DATA)[-1].body)
    ask(quick, DEPLOYMENT, type=4, mode=1)
    quick.frames.clear()
    ask(quick, BUILD_MAP, type=CANCEL)
    assert states(quick) == [UNINIT]
    quick.run(3.0)
    assert not pushed(quick, BUILD_MAP_DATA)
    assert scenes(quick) == before
    assert quick.chassis.scene.name == "wooshmap"
    assert set(quick.chassis.map.marks) == set(SteppedChassis().chassis.map.marks)
    # A new one begins empty.
    ask(quick, BUILD_MAP, type=ADD, sceneName="new", mapName="hall")
    quick.run(1.1)
    again = picture(pushed(quick, BUILD_MAP_DATA)[-1].body)
    assert (again == FREE).sum() < 0.9 * (seen == FREE).sum()
    save_map(quick)
    assert quick.chassis.map.marks == {}


def test_robot_without_a_pose_can_make_its_first_map() -> None:
    chassis = SteppedChassis(profile="instant", initialised=False)
    start_mapping(chassis)
    chassis.run(0.1)
    assert states(chassis)[-1] == MAPPING
    save_map(chassis)
    assert states(chassis)[-1] == UNINIT
    use_map(chassis)
    assert states(chassis)[-1] == IDLE


def asked(name: str, **body: Any) -> Callable[[JsonClient], object]:
    return lambda client: client.ask(name, body)


def nothing(client: JsonClient) -> None:
    pass


deployment = asked(SWITCH_WORK_MODE, mode=DEPLOYMENT_MODE)


def mapping(client: JsonClient) -> None:
    deployment(client)
    client.ask(BUILD_MAP, {"type": ADD, "sceneName": "new", "mapName": "hall"})


def manual_mapping(client: JsonClient) -> None:
    mapping(client)
    client.ask("woosh.robot.SwitchControlMode", {"mode": 2})


def task_paused(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "markNo": "A23"})
    deployment(client)
    wait_until(lambda: client.ask("woosh.robot.TaskProc")["state"] == PAUSED)


def of(scene: str, name: str, kind: int = ADD) -> Json:
    return {"type": kind, "sceneName": scene, "mapName": name}


REFUSED: list[tuple[Callable[[JsonClient], object], str, Json, str]] = [
    (nothing, BUILD_MAP, of("new", "hall"), "not in deployment mode"),
    (nothing, BUILD_MAP, of("", "", SAVE), "no map is being made"),
    (nothing, DEPLOYMENT, {"type": 4, "mode": 1}, "not in deployment mode"),
    (deployment, BUILD_MAP, {}, "unknown type 0 of BuildMap"),
    (deployment, BUILD_MAP, of("", "hall"), "scene_name is empty"),
    (deployment, BUILD_MAP, of("new", ""), "map_name is empty"),
    (deployment, BUILD_MAP, of("new", "a/b"), "map_name 'a/b' must be a name"),
    (deployment, BUILD_MAP, of("..", "hall"), "scene_name '..' must be a name"),
    (deployment, BUILD_MAP, of("new", "h" * 256), "at most 255 characters"),
    (
        deployment,
        BUILD_MAP,
        of("wooshmap", "wooshmap"),
        "map wooshmap of scene wooshmap exists already",
    ),
    (deployment, BUILD_MAP, of("wooshmap", "attic", UPDATE), "unknown map attic"),
    (deployment, BUILD_MAP, of("scenex", "scenex", UPDATE), "is not the current one"),
    (task_paused, BUILD_MAP, of("new", "hall"), "task 5 is paused: cancel it first"),
    (mapping, BUILD_MAP, of("new", "other"), "mapping of hall is running"),
    (manual_mapping, BUILD_MAP, of("", "", SAVE), "not in deployment mode and automatic"),
    (mapping, SWITCH_MAP, {"sceneName": "scenex"}, "map hall is being made"),
    (mapping, "woosh.map.Rename", {"newSceneName": "home"}, "map hall is being made"),
    (mapping, SWITCH_WORK_MODE, {"mode": TASK_MODE}, "map hall is being made"),
    (mapping, INIT_ROBOT, {"isRecord": True}, "map hall is being made"),
    (mapping, "woosh.robot.SetRobotPose", {"pose": {"x": 1, "y": 1}}, "map hall is being made"),
    (mapping, "woosh.robot.ExecTask", {"type": 1, "markNo": "A2"}, "deployment mode"),
    (deployment, DEPLOYMENT, {"type": 3, "mode": 1}, "collects marks only"),
    (deployment, DEPLOYMENT, {"type": 4, "mode": 2}, "collects marks only"),
    (deployment, DEPLOYMENT, {"type": 4, "mode": 1, "pose": {"x": 99}}, "outside map"),
]


@pytest.mark.parametrize("prepare", [nothing, deployment, task_paused, mapping, manual_mapping])
def test_bad_requests_are_refused_and_nothing_is_lost(
    client: JsonClient, prepare: Callable[[JsonClient], object]
) -> None:
    prepare(client)
    state, known = client.ask(STATE), client.ask(SCENE_LIST)
    for needed, name, body, reason in REFUSED:
        if needed is prepare:
            assert reason in client.refusal(name, body)
            assert (client.ask(STATE), client.ask(SCENE_LIST)) == (state, known), reason
    if state["state"] == MAPPING:
        client.ask("woosh.robot.SwitchControlMode", {"mode": 1})
        client.ask(BUILD_MAP, {"type": SAVE})
        assert client.ask(SCENE)["mapName"] == "hall"


def test_mapping_waits_while_it_is_started_and_ended(real: SteppedChassis) -> None:
    ask(real, SWITCH_WORK_MODE, mode=DEPLOYMENT_MODE)
    for kind in (ADD, SAVE):
        real.request(BUILD_MAP, type=kind, sceneName="new", mapName="hall")
        real.run(1.0)
        for other in (ADD, UPDATE, CANCEL, SAVE):
            answer = answer_to(real, BUILD_MAP, type=other, sceneName="wooshmap", mapName="other")
            assert answer.ok is False
        assert answer_to(real, DEPLOYMENT, type=4, mode=1).ok is False
        real.run(8.0)
    assert scenes(real)["new"] == ["hall"]
    # Cancelling takes its time, too, and leaves a robot to initialise.
    real.frames.clear()
    start_mapping(real, area="other")
    sent, answered = wait_answer(real, BUILD_MAP, type=CANCEL)
    assert answered - sent > 4.0
    assert wait_frame(real, shows(UNINIT)).time == answered
    ask(real, INIT_ROBOT, isRecord=True)
    assert states(real)[-1] == IDLE


@pytest.mark.chassis(speed=20, profile="tr200")
def test_clients_that_go_do_not_lose_the_map(client: JsonClient) -> None:
    with closing(JsonClient(client.simulator.port)) as other:
        mapping(other)
    client.subscribe(STATE)
    assert client.ask(STATE)["state"] == MAPPING
    with closing(JsonClient(client.simulator.port)) as other:
        other.send({"type": BUILD_MAP, "body": {"type": SAVE}, "sn": 99})
        client.simulator.wait_received(BUILD_MAP, 2)
    client.next_push(STATE, lambda body: body["state"] == UNINIT)
    assert client.ask(SCENE)["mapName"] == "hall"


def test_lost_robot_neither_adds_scans_nor_saves(quick: SteppedChassis) -> None:
    start_mapping(quick)
    quick.run(1.1)
    quick.chassis.lose_localisation()
    quick.run(1.1)
    assert states(quick)[-1] == FAULT
    seen = picture(pushed(quick, BUILD_MAP_DATA)[-1].body)
    turn_around(quick, 4.0)
    assert (picture(pushed(quick, BUILD_MAP_DATA)[-1].body) == seen).all()
    assert answer_to(quick, BUILD_MAP, type=SAVE).ok is False
    # A client may tell it where it is, and goes on.
    pose = quick.chassis.base.pose
    ask(quick, "woosh.robot.SetRobotPose", pose={"x": pose.x, "y": pose.y, "theta": pose.theta})
    turn_around(quick, 4.0)
    assert states(quick)[-1] == MAPPING
    more = picture(pushed(quick, BUILD_MAP_DATA)[-1].body)
    assert (more == FREE).sum() > 1.1 * (seen == FREE).sum()
    save_map(quick)


def test_emergency_stop_interrupts_the_drive_but_not_the_mapping(quick: SteppedChassis) -> None:
    start_mapping(quick)
    quick.chassis.set_emergency_stop(True)
    quick.run(0.1)
    assert states(quick)[-1] == FAULT
    assert answer_to(quick, TWIST, linear=0.2).ok is False
    quick.chassis.set_emergency_stop(False)
    quick.run(1.1)
    assert states(quick)[-1] == MAPPING
    assert pushed(quick, BUILD_MAP_DATA)


def test_map_that_becomes_too_large_keeps_what_it_has(
    quick: SteppedChassis, caplog: pytest.LogCaptureFixture
) -> None:
    start_mapping(quick)
    quick.run(1.1)
    before = pushed(quick, BUILD_MAP_DATA)[-1].body
    quick.chassis.base.place(Pose(300.0, 300.0, 0.0))
    quick.run(1.1)
    after = pushed(quick, BUILD_MAP_DATA)[-1].body
    assert (picture(after) == FREE).sum() >= (picture(before) == FREE).sum()
    assert len([each for each in caplog.messages if "map hall is full" in each]) == 1
    save_map(quick)


def test_scans_are_pushed_at_their_rate(real: SteppedChassis) -> None:
    real.run(1.0)
    assert not pushed(real, SCANNER_DATA)
    real.subscribe(SCANNER_DATA)
    real.run(2.0)
    found = pushed(real, SCANNER_DATA)
    periods = [after.time - before.time for before, after in pairwise(found)]
    assert periods == [pytest.approx(RATES["scan"], abs=0.001)] * 9
    assert len({str(frame.body["ranges"]) for frame in found}) == len(found)
    body = ask(real, SCANNER_DATA).body
    assert body in [frame.body for frame in pushed(real, SCANNER_DATA)[-2:]]
