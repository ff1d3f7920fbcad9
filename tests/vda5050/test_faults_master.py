"""A master control that sends rubbish, duplicates, and messages for somebody else."""

from __future__ import annotations

import itertools
import json
import logging
from functools import partial
from pathlib import Path
from typing import Any

import aiomqtt
import paho.mqtt.publish as publish
import pytest

from tests.asynchronous import eventually
from tests.vda5050.conftest import EXEC, Site
from tests.vda5050.master import (
    START,
    Master,
    Message,
    action,
    error_types,
    header,
    node,
    status_of,
)
from woosh_robot_agent.vda5050.mqtt import MAX_RECEIVED, ReceiveQueue

STAND: dict[str, Any] = {
    "orderId": "bad",
    "orderUpdateId": 0,
    "nodes": [node("a", 0, *START)],
    "edges": [],
}


def order(**changes: Any) -> bytes:
    return json.dumps(header() | STAND | changes).encode()


RUBBISH = {
    "no JSON": b"{",
    "no text": b"\xff\xfe\x00",
    "UTF-16": order().decode().encode("utf-16"),
    "deep": b"[" * 100_000,
    "nested": order().replace(b'"bad"', b"[" * 300 + b"]" * 300),
    "list": b"[1, 2]",
    "wrong types": order(nodes=7),
    "many defects": order(nodes=[1] * 20_000),
    "NaN": order(nodes=[node("a", 0, float("nan"), 0.0)]),
    "infinite": order().replace(b"4.23276472", b"1e999"),
    "huge number": order(orderUpdateId=10**30),
    "endless number": order().replace(b'"orderUpdateId": 0', b'"orderUpdateId": ' + b"9" * 5_000),
    "long text": order(orderId="x" * 100_000),
    "half a character": order(orderId="\ud800"),
    "10 MiB": order(padding="x" * 10 * 2**20),
    "another robot": order(serialNumber="30002"),
    "another manufacturer": order(manufacturer="Other"),
    "another version": order(version="1.1.0"),
    "no version": order(version=""),
}


async def test_rubbish_is_rejected_and_does_no_harm(site: Site) -> None:
    async with site.online() as master:
        for index, (name, payload) in enumerate(RUBBISH.items()):
            for topic in ("order", "instantActions"):
                master.send_raw(topic, payload)
            await master.wait_state(
                lambda state: error_types(state) == ["validationError"] * 2, f"errors for {name}"
            )
            good = order(orderId=f"good {index}").decode()
            master.send_raw("order", good.encode("utf-8-sig"))  # the byte order mark is ignored
            await master.wait_state(
                lambda state, index=index: (
                    state["orderId"] == f"good {index}" and state["errors"] == []
                ),
                f"a good order after {name}",
            )
    assert site.chassis.counts[EXEC] == 0


async def test_a_repeated_order_is_answered_by_a_state(site: Site) -> None:
    """A repetition with another content is ignored, as version 2.1 demands."""
    nodes = [node("a", 0, *START), node("b", 2, 8.0, -7.5, released=False)]
    async with site.online() as master:
        master.order(nodes)
        await master.accepted()
        for description in [""] * 5 + ["changed"] * 5:  # more than states that have other causes
            count = len(master.received["state"])
            master.order([nodes[0] | {"nodeDescription": description}, nodes[1]])
            await eventually(lambda before=count: len(master.received["state"]) > before)
            assert master.state["errors"] == []


async def test_a_rejection_hides_no_earlier_one_nor_those_of_instant_actions(site: Site) -> None:
    async with site.online() as master:
        for _ in range(2):
            master.order([node("a", 0, *START)], order_id="")
            await master.error("validationError")
        master.order([node("a", 0, 0.0, 0.0)], order_id="far")
        state = await master.error("noRouteError")
        of_orders = ["validationError", "noRouteError"]
        assert error_types(state) == of_orders
        master.send_raw("instantActions", b"{")
        await master.wait_state(lambda state: error_types(state) == [*of_orders, "validationError"])
        master.instant(action("stateRequest", "1"))
        assert error_types(await master.status("1", "FINISHED")) == of_orders
        master.order([node("a", 0, *START)])
        assert (await master.accepted())["errors"] == []


async def test_retained_messages_of_the_master_control_are_ignored(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    publish.single(
        "uagv/v2/Woosh/30001/order",
        order(),
        retain=True,
        hostname="127.0.0.1",
        port=site.broker.port,
    )
    with caplog.at_level(logging.WARNING):
        async with Master(site.broker.port) as master, site.vehicle():
            await master.online()
            await eventually(lambda: "a retained message on order was ignored" in caplog.text)
            assert master.state["orderId"] == ""
            # removed from the broker, as the log asks for
            publish.single(
                "uagv/v2/Woosh/30001/order", b"", hostname="127.0.0.1", port=site.broker.port
            )
            master.instant(action("stateRequest", "after it"))
            state = await master.wait_state(lambda state: "after it" in str(state["actionStates"]))
            assert not state["errors"]


async def test_a_flood_of_messages_does_not_stop_the_vehicle(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    async with site.online() as master:
        master.order([node("a", 0, *START), node("b", 2, 7.0, -7.0)])
        await master.accepted("order")
        for number in range(200):
            master.send_raw("order", order(orderId=f"flood {number}"))
            master.instant(action("stateRequest", str(number)), action("unknown", f"x{number}"))
        await master.reached("b")

        numbers = itertools.count()

        def ended() -> bool:  # with a new id each time, as a request of the flood may be dropped
            master.instant(action("stateRequest", f"last {next(numbers)}"))
            return any(
                each["actionId"].startswith("last") and each["actionStatus"] == "FINISHED"
                for each in master.state["actionStates"]
            )

        await eventually(ended)
        assert len(master.state["actionStates"]) <= 300
        assert len(master.state["errors"]) <= 30
    assert len(caplog.text) < 200_000


async def test_a_request_with_the_id_of_a_former_one_is_performed_again(
    site: Site, tmp_path: Path
) -> None:
    """As vda5050-sdk sends them, whose ids are constant."""
    requests = ["pause", "resume", "cancel-order"]
    nodes = [node("a", 0, *START), node("b", 2, 7.0, -7.0, released=False)]

    def is_finished(state: Message, name: str, *, paused: bool) -> bool:
        return state["paused"] == paused and status_of(state, name) == "FINISHED"

    async with Master(site.broker.port) as master:
        for run in range(2):  # the second one after a restart
            async with site.vehicle(state_folder=tmp_path):
                await master.online()
                for number in range(2 - run):  # each order waits for the release of its second node
                    name = f"{run}.{number}"
                    master.order(nodes, order_id=name)
                    await master.wait_state(lambda state, name=name: state["orderId"] == name)
                    for _ in range(2):
                        master.instant(action("startPause", "pause", blocking="NONE"))
                        await master.wait_state(partial(is_finished, name="pause", paused=True))
                        master.instant(action("stopPause", "resume", blocking="NONE"))
                        await master.wait_state(partial(is_finished, name="resume", paused=False))
                    master.instant(action("cancelOrder", "cancel-order", blocking="NONE"))
                    await master.wait_state(lambda state: state["nodeStates"] == [])
                    state = await master.wait_state(
                        partial(is_finished, name="cancel-order", paused=False)
                    )
                    assert state["errors"] == []
                    assert [each["actionId"] for each in state["actionStates"]] == requests
            master.received.clear()


def test_a_flood_on_one_topic_leaves_room_for_another() -> None:
    an_order = aiomqtt.Message("order", b"{}", 0, False, 0, None)
    inbox = ReceiveQueue()
    for _ in range(2 * MAX_RECEIVED):
        inbox.put_nowait(an_order)
    inbox.put_nowait(aiomqtt.Message("instantActions", b"{}", 0, False, 0, None))
    taken = [inbox.get_nowait().topic.value for _ in range(inbox.qsize())]
    assert taken == [*["order"] * MAX_RECEIVED, "instantActions"]
    inbox.put_nowait(an_order)
    assert inbox.qsize() == 1
