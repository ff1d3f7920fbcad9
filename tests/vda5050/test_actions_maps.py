"""Maps and positions, on the wire and at the chassis."""

from __future__ import annotations

import hashlib
import io
import threading
import time
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.asynchronous import eventually
from tests.fact_files import FOLDER
from tests.quick_chassis import edit_bodies, quick_config
from tests.vda5050.broker import Mosquitto, Recorder
from tests.vda5050.chassis_events import received, statuses
from tests.vda5050.conftest import AT_ONCE, Held, Site
from tests.vda5050.master import START, Message, action, error_types, node, result_of, status_of
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import Delete, SceneData, SceneList, Upload
from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot, SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_agent.vda5050.actions.map_actions import fetch, unpack
from woosh_robot_agent.vda5050.messages.state import ActionFailedError

SCENE = b"""
name: shed
maps:
  - {name: shed, id: 9, version: 4, walls: [[0, 0, 9, 0, 9, 9, 0, 9, 0, 0]]}
"""


def zipped(method: int = zipfile.ZIP_DEFLATED, /, **files: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name.replace("_", "."), content)
    return buffer.getvalue()


SHED = zipped(scene_yaml=SCENE)
_LZMA = zipped(zipfile.ZIP_LZMA, a=b"abc" * 100)
# the local header has 31 bytes with the name; then come 4 bytes, and the properties of LZMA
DAMAGED_LZMA = _LZMA[:35] + b"\xff" + _LZMA[36:]


@pytest.fixture
def server() -> Iterator[str]:
    """A web server with the file of a map; any other path is not found."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path == "/away":
                self.send_response(302)
                self.send_header("Location", "file:///etc/hostname")
                self.end_headers()
                return
            if self.path == "/slow.zip":
                time.sleep(1.0)
            self.send_response(200 if self.path == "/shed.zip" else 404)
            self.end_headers()
            self.wfile.write(SHED)

        def log_message(self, format: str, *args: object) -> None:
            """Log nothing."""

    web = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=web.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{web.server_port}"
    finally:
        web.shutdown()
        web.server_close()
        thread.join()


def maps(state: Message) -> dict[str, tuple[str, str]]:
    """Version and status of each map in a state, by its id."""
    return {
        each["mapId"]: (each["mapVersion"], each["mapStatus"]) for each in state.get("maps", [])
    }


async def test_maps_are_listed_enabled_and_deleted(site: Site) -> None:
    site.chassis.intercept(  # no push of a pose on the new map, because the robot stands
        lambda out: [] if out.type == full_name(PoseSpeed) and not out.request else [out]
    )
    async with site.online() as master:
        state = await master.wait_state(maps)
        assert maps(state) == {
            "wooshmap": ("147", "ENABLED"),
            "scenex": ("12", "DISABLED"),
            "scenex2": ("3", "DISABLED"),
        }
        master.instant(action("enableMap", "wrong", mapId="scenex", mapVersion="11"))
        state = await master.status("wrong", "FAILED")
        assert "no version 11 of the map scenex" in result_of(state, "wrong")

        master.instant(action("enableMap", "e", mapId="scenex", mapVersion="12"))
        state = await master.status("e", "FINISHED")
        assert {name: status for name, (_, status) in maps(state).items()} == {
            "wooshmap": "DISABLED",
            "scenex": "ENABLED",
            "scenex2": "DISABLED",
        }
        assert state["agvPosition"]["mapId"] == "scenex"
        master.instant(action("enableMap", "again", mapId="scenex", mapVersion="12"))
        await master.status("again", "FINISHED")
        assert site.chassis.counts[full_name(SwitchMap)] == 1

        master.instant(action("deleteMap", "used", mapId="scenex", mapVersion="12"))
        state = await master.status("used", "FAILED")
        assert "uses the map scenex" in result_of(state, "used")
        master.instant(action("deleteMap", "d1", mapId="scenex2", mapVersion="3"))
        state = await master.status("d1", "FINISHED")
        assert set(maps(state)) == {"wooshmap", "scenex"}
        master.instant(action("deleteMap", "d2", mapId="wooshmap", mapVersion="147"))
        state = await master.status("d2", "FINISHED")
        assert set(maps(state)) == {"scenex"}
        master.instant(action("deleteMap", "d3", mapId="wooshmap", mapVersion="147"))
        await master.status("d3", "FAILED")
    deleted = received(site.chassis, Delete)
    assert [(each.scene_name, each.map_name) for each in deleted] == [
        ("scenex", "scenex2"),
        ("wooshmap", ""),
    ]


async def test_the_marks_of_a_map_are_known_when_it_is_enabled(site: Site) -> None:
    async with site.online() as master:
        site.chassis.delay(full_name(SceneData), 0.5)
        master.instant(action("enableMap", "e", mapId="scenex", mapVersion="12"))
        await master.status("e", "FINISHED")
        mark = {"nodeId": "K10", "sequenceId": 2, "released": False, "actions": []}
        master.order([node("a", 0, *START, map_id="scenex"), mark])
        state = await master.accepted()
        assert state["errors"] == []


async def test_a_robot_drives_on_the_map_of_a_real_scene_which_has_the_id_0(
    broker: Mosquitto, recorder: Recorder
) -> None:
    options = quick_config(port=0, tcp_port=0, speed=20, scenes=(FOLDER / "real_scene",))
    with SimulatorThread(options) as chassis:
        pose, mark = chassis.state.pose, "758312C2"
        start = node("a", 0, pose.x, pose.y, map_id="Wego_Robotics_503")
        goal = {"nodeId": mark, "sequenceId": 2, "released": True, "actions": []}
        async with Site(chassis, broker, recorder).online() as master:
            assert master.state["agvPosition"]["mapId"] == "Wego_Robotics_503"
            await master.order_until_accepted([start, goal])
            ended = await master.reached(mark)
            assert ended["errors"] == []


async def test_a_position_on_another_map_is_initialised(site: Site) -> None:
    async with site.online() as master:
        pose = {"x": 1.0, "y": 2.0, "theta": 0.5}
        # the new pose must not be left to the next push, which comes after the end of the action
        push_again = site.chassis.intercept(
            lambda out: [] if out.type == full_name(PoseSpeed) and not out.sn else [out]
        )
        master.instant(action("initPosition", "i", **pose, mapId="scenex2", lastNodeId="lift"))
        state = await master.status("i", "FINISHED")
        push_again()
        place = state["agvPosition"]
        assert {key: place[key] for key in pose} == pytest.approx(pose)
        assert place["mapId"] == "scenex2"
        assert place["positionInitialized"]
        assert (state["lastNodeId"], state["lastNodeSequenceId"]) == ("lift", 0)
        master.order(
            [node("lift", 0, 1.0, 2.0, map_id="scenex2"), node("b", 2, 2.0, 2.0, map_id="scenex2")]
        )
        await master.reached("b")

        master.instant(action("initPosition", "out", **pose | {"x": 500.0}, mapId="scenex2"))
        state = await master.status("out", "FAILED")
        assert "outside map" in result_of(state, "out")
        master.instant(action("initPosition", "no", **pose, mapId="nowhere"))
        state = await master.status("no", "FAILED")
        assert "no map nowhere" in result_of(state, "no")
        assert error_types(state)[-2:] == ["actionError", "actionError"]
    assert site.chassis.counts[full_name(SwitchMap)] == 1
    assert site.chassis.counts[full_name(InitRobot)] == 2


async def test_a_position_is_kept_if_the_robot_refuses_to_send_its_pose(site: Site) -> None:
    def refuse_pose(out: Outgoing) -> list[Outgoing]:
        if out.type != full_name(PoseSpeed):
            return [out]
        return [replace(out, ok=False, body=PoseSpeed())] if out.request else []

    site.chassis.intercept(refuse_pose)
    async with site.online() as master:
        await master.wait_state(maps)
        master.instant(action("enableMap", "e", mapId="scenex", mapVersion="12"))
        await master.status("e", "FINISHED")
        master.instant(action("stateRequest", "s"))
        state = await master.status("s", "FINISHED")
        assert "agvPosition" in state


async def test_an_order_goes_on_when_the_robot_has_reported_its_pose_on_the_map(site: Site) -> None:
    async with site.online() as master, site.other_client() as gate:
        master.order([node("a", 0, *START), node("b", 2, START[0] + 1, START[1], map_id="scenex")])
        await master.error("drivingError")
        held = Held(site.chassis, lambda out: out.type == full_name(PoseSpeed))
        answer = await gate.request(SwitchMap(scene_name="scenex", map_name="scenex"))
        assert answer.ok
        await master.wait_state(lambda state: maps(state)["scenex"][1] == "ENABLED")
        await held.wait()
        held.release()
        await master.reached("b")


async def test_a_drive_is_not_disturbed_by_a_new_position_or_map(site: Site) -> None:
    async with site.online() as master:
        master.order([node("a", 0, *START), node("b", 2, -9.0, -2.0), node("c", 4, 9.0, 7.0)])
        await master.wait_state(lambda state: state["driving"])
        pose = {"x": 1.0, "y": 2.0, "theta": 0.5, "mapId": "wooshmap"}
        master.instant(
            action("initPosition", "i", **pose),
            action("enableMap", "e", mapId="scenex", mapVersion="12"),
        )
        await master.wait_state(
            lambda state: status_of(state, "i") == status_of(state, "e") == "FAILED"
        )
        await master.reached("c")
    assert (
        site.chassis.counts[full_name(InitRobot)] == site.chassis.counts[full_name(SwitchMap)] == 0
    )


async def test_a_map_is_downloaded(site: Site, server: str) -> None:
    shed = {"mapId": "shed", "mapVersion": "4", "mapDownloadLink": f"{server}/shed.zip"}
    digest = hashlib.sha256(SHED).hexdigest()
    async with site.online(limits=AT_ONCE) as master:
        master.instant(action("downloadMap", "hash", **shed, mapHash="0" * 64))
        state = await master.status("hash", "FAILED")
        assert digest in result_of(state, "hash")
        master.instant(action("downloadMap", "version", **shed | {"mapVersion": "5"}))
        state = await master.status("version", "FAILED")
        assert "has version 4 of the map, not version 5" in result_of(state, "version")
        assert "shed" not in maps(state)
        master.instant(action("downloadMap", "lost", **shed | {"mapDownloadLink": f"{server}/x"}))
        state = await master.status("lost", "FAILED")
        assert "404" in result_of(state, "lost")

        master.instant(
            action("downloadMap", "good", **shed, mapHash=digest),
            action("downloadMap", "twice", **shed),  # waits for the end of the other
        )
        state = await master.status("good", "FINISHED")
        assert maps(state)["shed"] == ("4", "DISABLED")
        assert maps(state)["wooshmap"] == ("147", "ENABLED")
        state = await master.status("twice", "FAILED")
        assert error_types(state)[-1] == "duplicateMap"
    passed = ["INITIALIZING", "RUNNING", "FINISHED"]
    await eventually(lambda: statuses(site.recorder, "good")[-3:] == passed)
    assert site.chassis.counts[full_name(Upload)] == 2


async def test_no_map_is_deleted_by_an_old_list(site: Site) -> None:
    def hide_a_map(answer: SceneList) -> None:
        for scene in answer.scenes:
            if scene.name == "scenex":
                scene.maps[:] = ["scenex2"]

    show = edit_bodies(site.chassis, SceneList, hide_a_map)
    async with site.online() as master:
        await master.wait_state(maps)
        show()  # as if somebody had just added the other map of the scene
        site.chassis.refuse(full_name(SceneList), "Request failed")
        master.instant(action("deleteMap", "d", mapId="scenex2", mapVersion="3"))
        state = await master.status("d", "FAILED")
        assert "did not send the list of its maps" in result_of(state, "d")
    assert site.chassis.counts[full_name(Delete)] == 0


async def test_a_downloaded_map_is_not_deleted_if_the_robot_does_not_list_it(
    site: Site, server: str
) -> None:
    shed = {"mapId": "shed", "mapVersion": "4", "mapDownloadLink": f"{server}/shed.zip"}

    answered: set[str] = set()

    def refuse_list(out: Outgoing) -> list[Outgoing]:
        answered.add(out.request)
        refuses = out.request == full_name(SceneList) and full_name(Upload) in answered
        return [replace(out, ok=False, msg="Request failed") if refuses else out]

    site.chassis.intercept(refuse_list)
    async with site.online() as master:
        await master.wait_state(maps)
        master.instant(action("downloadMap", "l", **shed))
        state = await master.status("l", "FAILED")
        assert "did not send the list of its maps" in result_of(state, "l")
    assert site.chassis.counts[full_name(Upload)] == 1
    assert site.chassis.counts[full_name(Delete)] == 0


async def test_a_redirection_to_a_local_file_is_not_followed(server: str) -> None:
    with pytest.raises(ActionFailedError, match="cannot be fetched"):
        await fetch(f"{server}/away")
    assert await fetch(f"{server}/shed.zip", hashlib.md5(SHED).hexdigest().upper()) == SHED


async def test_a_download_does_not_take_for_ever(server: str) -> None:
    with pytest.raises(ActionFailedError, match="takes too long"):
        await fetch(f"{server}/slow.zip", max_duration=0.2)


def test_only_usable_zip_files_are_unpacked() -> None:
    assert unpack(SHED) == {"scene.yaml": SCENE}
    for data, reason in (
        (b"no ZIP file", "no usable ZIP file"),
        (SHED[:-40], "no usable ZIP file"),
        (DAMAGED_LZMA, "no usable ZIP file"),
        (zipped(), "has 0 files"),
        (zipped(**{f"f{number}": b"" for number in range(201)}), "has 201 files"),
        (zipped(bomb=bytes(65 * 1024 * 1024)), "more than 67108864 bytes"),
        (zipped(**{"a/x": b"", "../a/x": b""}), "same name"),
    ):
        with pytest.raises(ActionFailedError, match=reason):
            unpack(data)
    assert unpack(zipped(**{"../../x": b"1", "/etc/y": b"2"})) == {"x": b"1", "etc/y": b"2"}
    files = {"scene.json": b"{}", "hall/map.png": b"1"}
    assert unpack(zipped(**files)) == files
    assert unpack(zipped(**{f"folder/{name}": data for name, data in files.items()})) == files
