"""Blocking types: what happens at the chassis and at the broker while an action runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.asynchronous import eventually
from tests.vda5050.chassis_events import commands, statuses, together
from tests.vda5050.conftest import AT_ONCE, Site
from tests.vda5050.master import START, Message, action, edge, node, result_of, status_of
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.vda5050 import store
from woosh_robot_agent.vda5050.messages.order import BlockingType
from woosh_robot_agent.vda5050.robot.link import Timing
from woosh_robot_agent.vda5050.store import replace_file


def lift(name: str, blocking: str, height: float = 0.1) -> Message:
    """A lift of about a second of real time."""
    return action("liftTo", name, blocking=blocking, height=height, speed=0.005)


def pick(name: str, blocking: str) -> Message:
    return action("pick", name, blocking=blocking)


async def test_an_action_that_blocks_nothing_runs_while_the_robot_drives(site: Site) -> None:
    async with site.online(limits=AT_ONCE) as master:
        passed = [lift("lift", "NONE")]
        nodes = [
            node("a", 0, *START),
            node("b", 2, 7.0, -4.0, actions=passed),
            node("c", 4, 9.0, 7.0),
        ]
        master.order(nodes)
        await master.wait_state(
            lambda state: state["driving"] and status_of(state, "lift") == "RUNNING"
        )
        await master.wait_state(
            lambda state: state["lastNodeId"] == "c" and status_of(state, "lift") == "FINISHED"
        )
    assert commands(site.chassis) == ["drive", "lift_control3 execute"]
    assert statuses(site.recorder, "lift") == ["WAITING", "INITIALIZING", "RUNNING", "FINISHED"]


async def test_soft_actions_for_which_the_robot_has_one_action_follow_each_other(
    site: Site,
) -> None:
    step = action("step", "step", blocking="SOFT", distance=0.3)
    turn = action("rotate", "turn", blocking="SOFT", angle=0.5)
    async with site.online() as master:
        master.order([node("a", 0, *START, actions=[step, turn])])
        await master.status("step", "FINISHED")
        await master.status("turn", "FINISHED")
    assert commands(site.chassis) == ["step_control execute"] * 2


async def test_an_instant_action_stops_a_drive_only_if_it_blocks(site: Site) -> None:
    async with site.online(limits=AT_ONCE) as master:
        master.order([node("a", 0, *START), node("b", 2, -9.0, -2.0), node("c", 4, 9.0, 7.0)])
        await master.wait_state(lambda state: state["driving"])
        master.instant(lift("free", "NONE", 0.02))
        await master.status("free", "FINISHED")
        assert commands(site.chassis) == ["drive", "lift_control3 execute"]
        master.instant(lift("soft", "SOFT"))
        running = await master.status("soft", "RUNNING")
        assert not running["paused"]  # nobody has asked for the pause
        await master.reached("c")
    assert commands(site.chassis)[2:] == ["pause", "lift_control3 execute", "continue"]
    assert statuses(site.recorder, "soft") == ["WAITING", "INITIALIZING", "RUNNING", "FINISHED"]


async def test_a_hard_instant_action_and_those_of_the_order_wait_for_each_other(site: Site) -> None:
    async with site.online(limits=AT_ONCE) as master:
        first, last = lift("first", "NONE"), action("drop", "last", blocking="SOFT")
        master.order([node("a", 0, *START, actions=[first])])
        await master.status("first", "RUNNING")
        master.instant(action("step", "step", blocking="HARD", distance=0.4, speed=0.02))
        await master.status("step", "WAITING")
        await master.status("step", "RUNNING")
        master.order([node("a", 0, *START, actions=[last])], order_id="second")
        await master.status("last", "WAITING")
        await master.status("last", "FINISHED")
    assert not together(site.recorder, ["first", "step"])
    assert not together(site.recorder, ["step", "last"])


async def test_an_action_of_an_edge_ends_with_the_edge(site: Site) -> None:
    async with site.online() as master:
        a, b, c = node("a", 0, *START), node("b", 2, 7.0, -4.0), node("c", 4, 9.0, 7.0)
        endless = action("liftTo", "lift", blocking="NONE", height=0.2, speed=0.001)
        words = action("speak", "words", blocking="NONE", text="caution")
        master.order([a, b, c], [edge(a, b, actions=[endless, words]), edge(b, c)])
        await master.status("lift", "RUNNING")
        left = await master.reached("b")
        ended = await master.wait_state(
            lambda state: status_of(state, "lift") not in ("RUNNING", "INITIALIZING")
        )
        assert left["driving"]
        assert result_of(ended, "lift") == "the vehicle has left the edge"
        assert status_of(ended, "words") == "FINISHED"
        assert site.chassis.state.spoken == ("caution",)
        await master.reached("c")
    assert commands(site.chassis).count("lift_control3 cancel") == 1
    assert site.chassis.state.column < 0.2


async def test_a_cancelled_order_ends_when_the_action_of_an_edge_has_ended(site: Site) -> None:
    async with site.online(timing=Timing(repeat_after=0.2)) as master:
        a, b, c = node("a", 0, *START), node("b", 2, 7.0, -4.0), node("c", 4, 9.0, 7.0)
        endless = action("liftTo", "lift", blocking="NONE", height=0.2, speed=0.001)
        master.order([a, b, c], [edge(a, b, actions=[endless]), edge(b, c)])
        await master.status("lift", "RUNNING")
        site.chassis.refuse(full_name(CallAction), "not now")
        await master.reached("b")
        master.instant(action("cancelOrder", "cancel"))
        await eventually(lambda: "cancel" in commands(site.chassis))
        sent = commands(site.chassis).count("lift_control3 cancel")
        await eventually(lambda: commands(site.chassis).count("lift_control3 cancel") > sent + 2)
        assert status_of(master.state, "cancel") == status_of(master.state, "lift") == "RUNNING"
        site.chassis.clear_faults()
        ended = await master.status("cancel", "FINISHED")
        assert status_of(ended, "lift") == "FAILED"


async def test_the_work_for_many_actions_grows_with_their_number(
    site: Site, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Otherwise the event loop, and so a stop, waits for seconds."""
    comparisons: list[BlockingType] = []
    writes: list[Path] = []

    def excludes_actions(blocking: BlockingType) -> bool:
        comparisons.append(blocking)
        return blocking in (BlockingType.SINGLE, BlockingType.HARD)

    def write(path: Path, content: bytes) -> None:
        writes.append(path)
        replace_file(path, content)

    monkeypatch.setattr(BlockingType, "excludes_actions", property(excludes_actions))
    monkeypatch.setattr(store, "replace_file", write)
    words = [action("speak", f"{number}", blocking="NONE", text="hi") for number in range(200)]
    async with site.online(state_folder=tmp_path / "state") as master:
        master.order([node("a", 0, *START, actions=words)])
        await master.wait_state(
            lambda state: (
                state["actionStates"]
                and all(
                    each["actionStatus"] in ("FINISHED", "FAILED") for each in state["actionStates"]
                )
            )
        )
    assert len(comparisons) <= 20 * len(words)
    assert len(writes) <= len(words)
