"""The connector ends in the middle of an order, and starts again."""

from __future__ import annotations

import json
import random
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.asynchronous import TIMEOUT, eventually
from tests.quick_chassis import set_speed
from tests.vda5050.chassis_events import commands
from tests.vda5050.conftest import EXEC, Site, left_by_a_kill, task_to
from tests.vda5050.master import START, Master, action, edge, error_types, node, nodes_left
from tests.vda5050.programs import running_connector
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ChangeNavMode, Speak
from woosh_robot_agent.pb.ros.action_pb2 import StepControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedbacks, kRosSuccess
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_agent.vda5050 import session, store
from woosh_robot_agent.vda5050.messages.state import ErrorType
from woosh_robot_agent.vda5050.robot import maps

FILE = "uagv-Woosh-30001.json"
FAST, NORMAL, HARDLY = 20.0, 1.0, 0.02
"""Speeds of the simulated time."""
NODES = [
    node("a", 0, *START),
    node("b", 2, 6.5, -7.0, theta=0.5),
    node("c", 4, 8.0, -7.5, theta=0.0),
]
"""Two legs: the robot turns to a heading at b."""


def saved(folder: Path) -> dict[str, Any]:
    """Content of the file."""
    content: dict[str, Any] = json.loads((folder / FILE).read_bytes())
    return content


async def test_the_order_goes_on_after_kill_9(site: Site, tmp_path: Path) -> None:
    async with Master(site.broker.port) as master:
        with running_connector(site.chassis, site.broker.url, tmp_path):
            await site.drive(master, NODES, then=HARDLY)
        await eventually(lambda: len(site.recorder.sent("connection")) == 2)
        online, broken = site.recorder.sent("connection")
        assert (online["connectionState"], broken["connectionState"]) == (
            "ONLINE",
            "CONNECTIONBROKEN",
        )
        assert broken["headerId"] == online["headerId"] + 1
        async with Master(site.broker.port) as late:  # the last will is retained
            await eventually(lambda: late.last("connection") == broken)
        master.received.clear()
        with running_connector(site.chassis, site.broker.url, tmp_path) as connector:
            state = await master.accepted("order")
            assert nodes_left(state) == "bc"
            assert site.chassis.counts[EXEC] == 1
            set_speed(site.chassis, FAST)
            ended = await master.reached("c")
            assert ended["errors"] == ended["nodeStates"] == []
            connector.terminate()
            assert connector.wait(TIMEOUT) == 0
        assert site.chassis.counts[EXEC] == 2
    for topic in ("state", "connection"):
        ids = [message["headerId"] for message in site.recorder.sent(topic)]
        assert all(before < after for before, after in pairwise(ids)), (topic, ids)


async def test_a_pause_survives_a_kill_and_a_second_one_while_it_is_restored(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[dict[str, Any]] = []
    replace_file = store.replace_file

    def replace_and_note(path: Path, content: bytes) -> None:
        written.append(json.loads(content))
        replace_file(path, content)

    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await site.drive(master, NODES, then=NORMAL)
            master.instant(action("startPause", "pause"))
            await master.status("pause", "FINISHED")
            left = left_by_a_kill(tmp_path / "state")
            before = saved(left)
        master.received.clear()
        monkeypatch.setattr(store, "replace_file", replace_and_note)
        async with site.vehicle(state_folder=left):
            await master.wait_state(lambda state: state["orderId"] == "order" and state["paused"])
            written_until_then = tuple(written)
            master.instant(action("stopPause", "stop"))
            await master.status("stop", "FINISHED")
            set_speed(site.chassis, FAST)
            await master.reached("c")
    assert commands(site.chassis) == ["drive", "pause", "continue", "drive"]
    assert written_until_then
    for record in written_until_then:
        assert record["task_id"] == before["task_id"] != 0
        assert [each["id"] for each in record["instant_actions"]] == ["pause"]


async def test_the_order_goes_on_when_the_robot_has_arrived_meanwhile(
    site: Site, tmp_path: Path
) -> None:
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await site.drive(master, NODES, then=HARDLY)
            left = left_by_a_kill(tmp_path / "state")
        master.received.clear()
        set_speed(site.chassis, FAST)
        await site.idle()
        async with site.vehicle(state_folder=left):
            ended = await master.reached("c")
            assert ended["errors"] == []
    assert site.chassis.counts[EXEC] == 2


async def test_an_order_can_be_stopped_after_a_restart_before_the_marks_are_known(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(maps, "_MARKS_WITHIN", 2 * TIMEOUT)
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await site.drive(master, NODES, then=NORMAL)
            left = left_by_a_kill(tmp_path / "state")
        master.received.clear()
        site.chassis.mute(full_name(SceneData))
        async with site.vehicle(state_folder=left):
            await master.online()
            master.instant(action("startPause", "p"))
            await master.status("p", "FINISHED")
    assert commands(site.chassis) == ["drive", "pause"]


async def test_a_robot_that_its_own_action_has_moved_goes_on(site: Site, tmp_path: Path) -> None:
    step = action("step", "step", distance=1.0)
    first, second = node("a", 0, *START, actions=[step]), NODES[1]
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path):
            await master.online()
            master.order([first, second | {"released": False}])
            await master.status("step", "FINISHED")
        master.received.clear()
        async with site.vehicle(state_folder=tmp_path):
            await master.online()
            master.order([first, second], update=1)
            ended = await master.reached("b")
            assert ended["errors"] == []


async def test_a_robot_that_was_moved_meanwhile_does_not_go_on(site: Site, tmp_path: Path) -> None:
    async with Master(site.broker.port) as master:
        first, second, third = NODES
        async with site.vehicle(state_folder=tmp_path):
            await master.online()
            master.order([first, second, third | {"released": False}])
            await master.reached("b")
        async with site.other_client() as gate:
            assert (await gate.request(task_to(5.0, -6.7))).ok
            await eventually(lambda: abs(site.chassis.state.pose.x - 5.0) < 0.1)
            await site.idle()
        async with site.vehicle(state_folder=tmp_path):
            await eventually(lambda: master.last("connection")["connectionState"] == "ONLINE")
            master.order([second, third], update=1)
            state = await master.error("interruptedError")
            assert state["orderUpdateId"] == 1
            assert nodes_left(state) == "c"
            assert site.chassis.counts[EXEC] == 2


async def test_a_task_whose_start_was_not_answered_is_found_again(
    site: Site, tmp_path: Path
) -> None:
    site.chassis.mute(EXEC)
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await master.online()
            master.order(NODES[:2])
            await eventually(lambda: site.chassis.counts[EXEC])
            left = left_by_a_kill(tmp_path / "state")
        async with site.vehicle(state_folder=left):
            ended = await master.reached("b")
            assert ended["errors"] == []
    assert site.chassis.counts[EXEC] == 1


async def test_a_task_that_was_never_sent_is_not_driven(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, left = tmp_path / "state", tmp_path / "state+"
    replace_file = store.replace_file

    def replace_and_copy(path: Path, content: bytes) -> None:
        """Copy the file as a kill leaves it after the task was saved and before it is sent."""
        replace_file(path, content)
        if saved(folder)["task_id"] and not left.exists():
            left_by_a_kill(folder)

    site.chassis.refuse(EXEC, "no")
    async with Master(site.broker.port) as master:
        with monkeypatch.context() as patched:
            patched.setattr(store, "replace_file", replace_and_copy)
            async with site.vehicle(state_folder=folder):
                await master.online()
                master.order(NODES[:2])
                await eventually(lambda: left.exists() and site.chassis.counts[EXEC])
        site.chassis.clear_faults()
        async with site.vehicle(state_folder=left):
            await master.error("drivingError")
    assert site.chassis.counts[EXEC] == 1


async def test_a_connector_that_is_killed_again_and_again_repeats_nothing(
    site: Site, tmp_path: Path
) -> None:
    chance = random.Random(5)
    folder, kills = tmp_path / "state", 0
    async with Master(site.broker.port) as master:
        while master.state.get("lastNodeId") != "c":
            set_speed(site.chassis, 0.5 if kills < 3 else 5.0)
            async with site.vehicle(state_folder=folder):
                master.received.clear()
                await eventually(lambda: master.state)
                if not kills:
                    master.order(NODES)
                    await master.accepted("order")
                assert master.state["errors"] == []
                further = site.chassis.state.odometer + chance.uniform(0.0, 0.4)
                await eventually(
                    lambda goal=further: (
                        site.chassis.state.odometer >= goal or master.state["lastNodeId"] == "c"
                    )
                )
                folder, kills = left_by_a_kill(folder), kills + 1
    assert kills > 2
    assert site.chassis.counts[EXEC] == 2


async def test_what_begins_is_saved_before_the_robot_is_told(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a kill in between would repeat an action, hide it from `startPause` and
    `cancelOrder`, or leave a speed limit at the robot for ever."""
    at_command: dict[str, dict[str, Any]] = {}
    replace_file = store.replace_file

    def write_slowly(path: Path, content: bytes) -> None:
        time.sleep(0.2)  # so that a command that is sent too early is noticed
        replace_file(path, content)

    def note(out: Outgoing) -> list[Outgoing]:
        if out.request and (tmp_path / FILE).exists():
            at_command.setdefault(out.request, saved(tmp_path))
        return [out]

    monkeypatch.setattr(store, "replace_file", write_slowly)
    async with site.online(state_folder=tmp_path) as master:
        site.chassis.intercept(note)
        words = action("speak", "words", blocking="HARD", text="hello")
        step = action("step", "step", blocking="HARD", distance=0.2)
        a, b = node("a", 0, *START, actions=[words, step]), node("b", 2, 7.0, -7.0)
        master.order([a, b], [edge(a, b, maxSpeed=0.3)])
        await master.reached("b")
    spoken = at_command[full_name(Speak)]["order"]["actions"]["states"]
    assert [each["status"] for each in spoken if each["id"] == "words"] == ["INITIALIZING"]
    assert at_command[full_name(CallAction)]["calls"] == [full_name(StepControl)]
    assert at_command[full_name(ChangeNavMode)]["speed_is_limited"]


async def test_what_has_ended_is_not_repeated_after_a_restart(site: Site, tmp_path: Path) -> None:
    words = action("speak", "words", text="once")
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path):
            await master.online()
            master.instant(words)
            await master.status("words", "FINISHED")
            master.order(NODES[:2])
            await master.reached("b")
            master.instant(words)
            await master.error("instantActionError")
        master.received.clear()
        async with site.vehicle(state_folder=tmp_path):
            await master.online()
            master.order(NODES[:2])
            master.instant(words, action("stateRequest", "last"))
            await master.status("last", "FINISHED")
            assert (master.state["orderId"], master.state["lastNodeId"]) == ("order", "b")
    assert site.chassis.counts[EXEC] == 1
    assert site.chassis.state.spoken == ("once",)


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"[]", b"[" * 100_000, b"\xff"),
        *(b'{"order": {"leg_length": 1}}', b'{"calls": ["woosh.ros.action.Newer"]}'),
    ],
)
def test_a_damaged_file_is_put_aside(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / FILE
    file.write_bytes(content)
    opened = store.Store(tmp_path, FILE.removesuffix(".json"))
    record, error = opened.open()
    opened.close()
    assert record.order.order_id == ""
    assert error is not None
    assert error.type == ErrorType.STATE_FILE
    assert file.with_suffix(".damaged").read_bytes() == content


def test_a_file_that_could_not_be_read_is_read_when_that_is_corrected(tmp_path: Path) -> None:
    (tmp_path / FILE).mkdir()
    opened = store.Store(tmp_path, FILE.removesuffix(".json"))
    with pytest.raises(OSError):
        opened.open()
    (tmp_path / FILE).rmdir()
    assert opened.open() == (store.Record(), None)
    opened.close()


async def test_a_vehicle_reports_a_damaged_file_until_its_next_order(
    site: Site, tmp_path: Path
) -> None:
    file = tmp_path / FILE
    file.write_bytes(b"[]")
    async with Master(site.broker.port) as master, site.vehicle(state_folder=tmp_path):
        state = await master.error("stateFileError")
        assert state["orderId"] == ""
        master.order([node("a", 0, *START)])
        await master.wait_state(lambda state: state["orderId"] == "order" and not state["errors"])
    assert saved(tmp_path)["order"]["order_id"] == "order"


async def test_an_action_that_waited_for_another_is_performed_after_a_kill(
    site: Site, tmp_path: Path
) -> None:
    words = action("speak", "words", blocking="HARD", text="hello")
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path):
            await master.online()
            master.instant(action("liftTo", "lift", blocking="NONE", height=0.5, speed=0.001))
            await master.status("lift", "RUNNING")
            master.order([node("a", 0, *START, actions=[words])])
            await eventually(lambda: saved(tmp_path)["order"]["actions"]["running"])
            left = left_by_a_kill(tmp_path)
        assert site.chassis.state.spoken == ()
        master.received.clear()
        async with site.vehicle(state_folder=left):
            state = await master.status("words", "FINISHED")
            assert "interruptedError" not in error_types(state)
    assert site.chassis.state.spoken == ("hello",)


@pytest.mark.parametrize(
    ("kind", "what"), [("startPause", "step"), ("startPause", "pick"), ("cancelOrder", "pick")]
)
async def test_what_an_action_has_begun_before_a_kill_is_stopped(
    site: Site, tmp_path: Path, kind: str, what: str
) -> None:
    step = action("step", "step", distance=2.0, speed=0.1)
    pick = action("pick", "pick", stationName="U5")
    nodes = [node("a", 0, *START, actions=[step]), node("b", 2, 6.0, -7.0)]
    if what == "pick":
        nodes = [node("a", 0, *START), node("b", 2, 2.0, -7.0, actions=[pick])]
        nodes.append(node("c", 4, 2.0, -6.0))
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await master.online()
            master.order(nodes)
            await master.status(what, "RUNNING")
            set_speed(site.chassis, 0.05)
            await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
            left = left_by_a_kill(tmp_path / "state")
        master.received.clear()
        async with site.vehicle(state_folder=left):
            await master.status(what, "FAILED")
            await master.error("interruptedError")
            assert site.chassis.state.velocity.speed > 0.0
            set_speed(site.chassis, NORMAL)
            master.instant(action(kind, "stop"))
            await master.status("stop", "FINISHED")
            assert site.chassis.state.velocity.speed == 0.0
    last = {"startPause": "pause", "cancelOrder": "cancel"}[kind]
    assert commands(site.chassis)[-1].split()[-1] == last
    assert len(commands(site.chassis)) == (2 if what == "step" else 3)


async def test_an_action_that_has_ended_before_the_restart_is_not_cancelled(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "_RETRY", 0.2)
    step = action("step", "step", distance=0.5, speed=0.1)
    asked = full_name(Feedbacks)
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await master.online()
            master.order([node("a", 0, *START, actions=[step])])
            await master.status("step", "RUNNING")
            left = left_by_a_kill(tmp_path / "state")
        set_speed(site.chassis, FAST)
        actions = site.chassis.call(lambda simulator: simulator.chassis.actions)
        await eventually(
            lambda: kRosSuccess in [each.state for each in list(actions.last.values())]
        )
        former = store.Store(left, FILE.removesuffix(".json"))
        former.open()  # the former process has not quite ended
        before = site.chassis.counts[asked]
        async with site.vehicle(state_folder=left):
            await eventually(lambda: site.chassis.counts[asked] > before + 1)
            former.close()
            master.received.clear()
            await master.online()
            await master.status("step", "FAILED")
            master.instant(action("cancelOrder", "cancel"))
            await master.status("cancel", "FAILED")  # nothing is left to cancel
    assert commands(site.chassis) == ["step_control execute"]


async def test_a_charge_that_a_kill_interrupts_while_the_robot_docks_is_not_paused_later(
    site: Site, tmp_path: Path
) -> None:
    site.lower_battery()
    charge = action("startCharging", "charge")
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await master.online()
            nodes = [node("a", 0, *START), node("b", 2, -9.5, 0.5, actions=[charge])]
            master.order([*nodes, node("c", 4, *START)])
            await master.status("charge", "RUNNING")
            set_speed(site.chassis, HARDLY)
            left = left_by_a_kill(tmp_path / "state")
        master.received.clear()
        async with site.vehicle(state_folder=left):
            await master.status("charge", "FAILED")
            set_speed(site.chassis, FAST)
            state = await master.wait_state(lambda state: state["batteryState"]["charging"])
            assert error_types(state) == ["interruptedError"]  # the order does not wait for it
            master.instant(action("startPause", "pause"))
            await master.status("pause", "FINISHED")
    assert commands(site.chassis) == ["drive", "charge C1"]


async def test_a_second_connector_on_the_same_machine_stays_offline(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with site.online(state_folder=tmp_path) as master:
        async with site.vehicle(state_folder=tmp_path):
            await eventually(lambda: "another connector uses" in caplog.text)
        assert master.state["errors"] == []
        assert len(site.recorder.sent("connection")) == 1


async def test_a_file_that_cannot_be_written_is_an_error_of_the_state(
    site: Site, tmp_path: Path
) -> None:
    file = tmp_path / FILE
    async with site.online(state_folder=tmp_path) as master:
        file.with_suffix(".new").mkdir()  # nothing can be written there any more
        master.order([node("a", 0, *START)])
        await master.error("stateFileError")
        assert not file.exists()  # an old record could repeat what was done
        file.with_suffix(".new").rmdir()
        master.order([node("a", 0, *START)], order_id="next")
        await master.wait_state(lambda state: state["orderId"] == "next" and not state["errors"])
    assert file.exists()
