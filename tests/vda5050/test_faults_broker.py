"""The broker is lost, is not there, or refuses the connector."""

from __future__ import annotations

import asyncio
import gc
import json
import logging
import signal
from pathlib import Path

import pytest

from tests.asynchronous import TIMEOUT, eventually
from tests.quick_chassis import set_speed
from tests.vda5050.broker import Mosquitto
from tests.vda5050.chassis_events import commands
from tests.vda5050.conftest import EXEC, LEG, Site
from tests.vda5050.master import START, Master, action, error_types, node, nodes_left, status_of
from tests.vda5050.programs import running_connector
from woosh_robot_agent.motion.timeliness import boot_time
from woosh_robot_agent.vda5050 import mqtt
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.messages.versions import V2_1, Identity
from woosh_robot_agent.vda5050.mqtt import (
    BrokerConfig,
    MqttConnection,
    Publication,
    refused_topics,
)
from woosh_robot_agent.vda5050.reports import HeaderIds, Reports
from woosh_robot_agent.vda5050.session import OtherConnectorDetector


async def test_what_is_released_is_finished_without_the_broker(site: Site) -> None:
    _, second, third = nodes = [
        node("a", 0, *START),
        node("b", 2, 6.0, -7.0, theta=0.0),
        node("c", 4, 7.0, -7.0, released=False),
    ]
    async with site.vehicle():
        async with Master(site.broker.port) as master:
            await site.drive(master, nodes)
            before = master.state["headerId"]
        site.broker.stop()
        set_speed(site.chassis, 20.0)
        await eventually(lambda: abs(site.chassis.state.pose.x - 6.0) < 0.05)
        site.broker.start()
        async with Master(site.broker.port) as master:
            await master.online()
            state = await master.reached("b")
            assert nodes_left(state) == "c"
            assert state["errors"] == []
            assert state["headerId"] > before
            assert master.last("factsheet")
            assert site.chassis.counts[EXEC] == 1
            master.order(nodes)  # a master control that repeats what was not acknowledged
            master.order([second, third | {"released": True}], update=1)
            await master.reached("c")
    assert site.chassis.counts[EXEC] == 2


async def test_a_broker_that_comes_later_is_found(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.broker.stop()
    async with site.vehicle():
        await eventually(lambda: "check that the broker runs" in caplog.text)
        site.broker.start()
        async with Master(site.broker.port) as master:
            await master.online()
    assert caplog.text.count("check that the broker runs") == 1


def connection_to(url: str) -> MqttConnection:
    """A connection that reads orders, and was not begun."""
    will, topics = Publication("will", "gone"), {"order": lambda payload, retained: None}
    return MqttConnection(BrokerConfig.from_url(url), "1", lambda: will, topics, {}, lambda: None)


async def test_a_broker_that_dies_while_messages_are_sent_leaves_no_traceback(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    connection = connection_to(site.broker.url)
    running = asyncio.create_task(connection.run())
    for qos in (0, 1):
        await eventually(lambda: connection.connected)
        site.broker.stop()  # the event loop sends the message before it notices
        connection.publish(Publication("state", "x" * 100_000, qos))
        await eventually(lambda: not connection.connected)
        site.broker.start()
    running.cancel()
    await asyncio.wait({running})
    gc.collect()  # tells asyncio of exceptions that nobody has looked at
    said = [each.getMessage() for each in caplog.records if each.levelno >= logging.WARNING]
    assert said
    assert all(each.startswith("no connection to the broker") for each in said), said


async def test_a_connection_to_a_broker_that_hangs_can_be_ended(broker: Mosquitto) -> None:
    connection = connection_to(broker.url)
    running = asyncio.create_task(connection.run())
    await eventually(lambda: connection.connected)
    with broker.frozen():
        connection.publish(Publication("state", "x" * 30_000_000))  # fills the send buffer
        await asyncio.sleep(0.5)
        running.cancel()
        await asyncio.wait({running}, timeout=15.0)
        has_ended = running.done()
    running.cancel()
    await asyncio.wait({running})
    assert has_ended


async def test_a_connection_that_is_given_up_while_it_begins_is_closed() -> None:
    begun, ended = asyncio.Event(), asyncio.Event()
    received: list[bytes] = []

    async def never_answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        received.append(await reader.read(1000))
        begun.set()
        received.append(await reader.read())
        writer.close()
        ended.set()

    async with await asyncio.start_server(never_answer, "127.0.0.1", 0) as server:
        url = f"mqtt://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        running = asyncio.create_task(connection_to(url).run())
        await begun.wait()
        running.cancel()
        await asyncio.wait_for(ended.wait(), TIMEOUT)
        await asyncio.wait({running})
    disconnect = b"\xe0\x00"  # without it, the broker would publish the last will
    assert received[1] == disconnect


async def test_two_connectors_of_a_robot_are_detected(site: Site) -> None:
    async with site.online(gone_after=5.0) as master:
        async with site.vehicle(gone_after=5.0):
            await master.error("secondConnectorError")
            master.order([node("a", 0, *START), node("b", 2, 6.0, -7.0)])
            await master.accepted("order")
            master.instant(action("speak", "words", text="alone"))
            await master.status("words", "WAITING")
            assert site.chassis.counts[EXEC] == 0
            assert site.chassis.state.spoken == ()
        await master.wait_state(
            lambda state: "secondConnectorError" not in error_types(state),
            "the other connector to be gone",
        )
        await eventually(lambda: master.last("connection")["connectionState"] == "ONLINE")


async def test_a_step_that_waits_does_not_begin_beside_a_second_connector(site: Site) -> None:
    set_speed(site.chassis, 0.5)
    async with site.online() as master:
        steps = {"blocking": "SOFT", "distance": 0.2, "speed": 0.02}
        master.instant(action("step", "one", **steps), action("step", "two", **steps))
        await master.status("one", "RUNNING")
        await master.status("two", "INITIALIZING")
        master.send("connection", {"connectionState": "ONLINE"})
        await master.error("secondConnectorError")
        set_speed(site.chassis, 20.0)
        await master.status("one", "FINISHED")
        master.instant(action("stateRequest", "r"))
        await master.status("r", "FINISHED")
        assert commands(site.chassis) == ["step_control execute"]
        master.send("connection", {"connectionState": "OFFLINE"})
        await master.status("two", "FINISHED")


def reports_with(header_ids: HeaderIds) -> tuple[Reports, MqttConnection]:
    """Messages of a vehicle, and a connection that was not begun."""
    reports = Reports(V2_1, Limits(), lambda: None, lambda: None, lambda: None)
    reports.open(Identity("Woosh", "1"), "uagv", header_ids)
    mqtt = MqttConnection(BrokerConfig("", 1), "1", reports.last_will, {}, {}, lambda: None)
    reports.mqtt = mqtt
    return reports, mqtt


async def test_a_vehicle_knows_its_last_will_however_often_it_tries_to_connect() -> None:
    reports, mqtt = reports_with(HeaderIds())
    # the broker may publish the will of an attempt whose answer was lost
    wills = [reports.last_will() for _ in range(100)]
    mqtt.connected = True
    reports.announce()
    wills += [reports.last_will() for _ in range(100)]
    assert all(reports.is_own_connection(each.payload.encode()) for each in wills)
    assert not reports.is_own_connection(b"{}")


async def test_a_second_online_leaves_the_header_id_to_the_last_will() -> None:
    reports, mqtt = reports_with(HeaderIds())
    published = [reports.last_will()]
    mqtt.connected = True
    mqtt.publish = published.append  # type: ignore[method-assign]
    reports.announce()
    reports.announce()  # e.g. because a second connector has replaced the first one
    ids = [json.loads(each.payload)["headerId"] for each in published]
    assert len(set(ids)) == 3, ids


async def test_a_last_will_that_was_published_keeps_its_header_id_over_a_restart() -> None:
    saved: dict[str, int] = {}
    ids = HeaderIds(saved, saved.update)
    reports, mqtt = reports_with(ids)
    will = json.loads(reports.last_will().payload)
    mqtt.connected = True
    reports.announce()
    mqtt.connected = False
    await reports.close(0.0)
    ids.close()
    assert saved["connection"] > will["headerId"]


async def test_another_connector_whose_end_was_missed_is_gone_after_a_while() -> None:
    other = OtherConnectorDetector(lambda payload: False, lambda: None, gone_after=0.0)
    other.connected()
    other.received(b'{"connectionState": "ONLINE"}', False)
    assert other.error is not None
    other.connected()
    await eventually(lambda: other.error is None)


async def test_an_old_offline_that_a_broker_has_restored_is_no_other_connector() -> None:
    other = OtherConnectorDetector(lambda payload: False, lambda: None, gone_after=TIMEOUT)
    for _ in range(2):
        other.connected()
        other.received(b'{"connectionState": "OFFLINE"}', True)
        assert other.error is None
    other.received(b'{"connectionState": "CONNECTIONBROKEN"}', True)
    assert other.error is not None
    other.close()


def test_topics_that_the_vehicle_may_not_read_are_found() -> None:
    assert refused_topics(["order", "instantActions"], [0, 0x80]) == ["instantActions"]


async def test_an_order_that_came_while_the_connector_was_suspended_is_not_driven(
    site: Site, tmp_path: Path
) -> None:
    set_speed(site.chassis, 1.0)  # the broker takes half a minute to report the connector as lost
    async with Master(site.broker.port) as master:
        with running_connector(site.chassis, site.broker.url, tmp_path) as connector:
            await master.online()
            connector.send_signal(signal.SIGSTOP)
            master.order(LEG)
            master.instant(action("startPause", "p"), action("stopPause", "s"))
            await eventually(
                lambda: master.last("connection")["connectionState"] == "CONNECTIONBROKEN"
            )
            connector.send_signal(signal.SIGCONT)
            await eventually(lambda: master.last("connection")["connectionState"] == "ONLINE")
            master.instant(action("stateRequest", "r"))
            await master.status("r", "FINISHED")
            assert master.state["orderId"] == ""
            assert (status_of(master.state, "p"), status_of(master.state, "s")) == ("FINISHED", "")
            assert master.state["paused"]
    assert site.chassis.counts[EXEC] == 0


async def test_a_cancel_that_came_while_the_connector_was_suspended_is_performed(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with site.online() as master:
        await site.drive(master)
        connections = len(master.received["connection"])
        monkeypatch.setattr(mqtt, "_DRAIN", 5.0)  # enough for a busy machine
        monkeypatch.setattr(mqtt, "boot_time", lambda: boot_time() + 6.0)
        master.instant(action("cancelOrder", "c"))
        master.order(LEG, order_id="old")
        await master.status("c", "FINISHED")
        # connected anew
        await eventually(lambda: len(master.received["connection"]) > connections)
        assert master.state["orderId"] == "order"
    assert site.chassis.counts[EXEC] == 1


def test_no_header_id_is_used_twice_whenever_the_program_ends() -> None:
    saved: dict[str, int] = {}
    used = []
    for _ in range(5):
        ids = HeaderIds(saved, saved.update)
        for _ in range(1500):
            number = ids.next("state")
            assert number < saved["state"]
            used.append(number)
    assert used == sorted(set(used))


def test_header_ids_begin_again_after_32_bits() -> None:
    ids = HeaderIds({"state": 2**32 - 2})
    assert [ids.next("state") for _ in range(4)] == [2**32 - 2, 2**32 - 1, 0, 1]
