"""What survives a restart: the state of an order, and the header ids."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.vda5050.orders import action, at, path, place
from woosh_robot_agent.data_files import structure
from woosh_robot_agent.vda5050.messages.order import Action, BlockingType
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType
from woosh_robot_agent.vda5050.orders.legs import Perform
from woosh_robot_agent.vda5050.orders.machine import OrderMachine, OrderMemory
from woosh_robot_agent.vda5050.reports import HeaderIds
from woosh_robot_agent.vda5050.store import Record, Store, StoreInUseError, to_json


def restarted(machine: OrderMachine) -> OrderMachine:
    """Return a machine that has only what JSON has kept of the other one."""
    memory = structure(
        OrderMemory, json.loads(to_json(machine.memory)), "", known_only=False, own=True
    )
    assert memory == machine.memory
    after = OrderMachine()
    after.restore(memory)
    return after


def arrived() -> OrderMachine:
    """A machine that has just reached the node of an action, which is not commanded yet."""
    machine = OrderMachine()
    machine.moved(at(0.0))
    lift = Action("lift", "lift", parameters={"height": 0.5, "deep": {"x": [1, None]}})
    machine.receive(
        path(
            "abc",
            "d",
            b=place(1.0, theta=0.0),
            actions={"ab": [action("speak", BlockingType.NONE)], "b": [lift]},
            edges={"bc": {"max_speed": 0.5}},
        )
    )
    machine.poll()
    machine.action_changed("speak", ActionStatus.FINISHED)
    machine.drive_ended("")
    return machine


def test_an_action_that_ran_has_failed_and_stops_the_order_if_it_forbids_driving() -> None:
    machine = arrived()
    assert [type(each) for each in machine.poll()] == [Perform]
    after = restarted(machine)
    after.moved(at(1.0))
    assert after.poll() == []
    assert {each.id: each.status for each in after.status.actions}["lift"] is ActionStatus.FAILED
    assert after.error is not None
    assert after.error.type == ErrorType.INTERRUPTED.value


def test_a_triggered_action_starts_only_where_its_node_is() -> None:
    machine = arrived()
    after = restarted(machine)
    assert after.poll() == []  # the position is not known yet
    after.moved(at(5.0))
    assert after.poll() == []
    assert after.error is not None
    again = restarted(machine)
    again.moved(at(1.0))
    assert [type(each) for each in again.poll()] == [Perform]


@pytest.mark.parametrize(
    "data",
    [
        {"nodes": 3},
        {"order_id": 5},
        {"nodes": [{"id": "a"}]},
        {"actions": [{"id": "1", "type": "x", "status": "NEVER"}]},
        {"canceling": "yes"},
        [],
        None,
    ],
)
def test_data_of_another_kind_is_refused(data: object) -> None:
    with pytest.raises(ValueError):
        structure(OrderMemory, data, "", known_only=False, own=True)


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


def test_after_an_orderly_end_the_header_ids_have_no_gap() -> None:
    saved: dict[str, int] = {}
    ids = HeaderIds(saved, saved.update)
    assert [ids.next("state") for _ in range(3)] == [0, 1, 2]
    ids.close()
    assert HeaderIds(saved).next("state") == 3


def test_header_ids_begin_again_after_32_bits() -> None:
    ids = HeaderIds({"state": 2**32 - 2})
    assert [ids.next("state") for _ in range(4)] == [2**32 - 2, 2**32 - 1, 0, 1]


def test_a_file_that_could_not_be_read_is_read_when_that_is_corrected(tmp_path: Path) -> None:
    obstacle = tmp_path / "vehicle.json"
    obstacle.mkdir()
    store = Store(tmp_path, "vehicle")
    with pytest.raises(OSError):
        store.open()
    obstacle.rmdir()
    assert store.open() == (Record(), None)
    with pytest.raises(StoreInUseError):
        Store(tmp_path, "vehicle").open()
    store.close()
