"""What survives a restart: the state of an order, and the header ids."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from woosh_robot_agent.vda5050.messages.order import Action, BlockingType, Edge, Node, NodePosition
from woosh_robot_agent.vda5050.messages.order import Order as VehicleOrder
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType, Position
from woosh_robot_agent.vda5050.orders.actions import OrderMemory
from woosh_robot_agent.vda5050.orders.legs import Perform
from woosh_robot_agent.vda5050.orders.machine import OrderMachine
from woosh_robot_agent.vda5050.reports import HeaderIds
from woosh_robot_agent.vda5050.store import Record, Store, StoreInUseError, from_plain, to_json

HARD, NONE = BlockingType.HARD, BlockingType.NONE


def place(x: float, *, theta: float | None = None) -> NodePosition:
    return NodePosition(x, 0.0, "map", theta)


def here(x: float) -> Position:
    return Position(x, 0.0, 0.0, "map", True)


def an_order() -> VehicleOrder:
    lift = Action("lift", "lift", HARD, {"height": 0.5, "name": "a", "deep": {"x": [1, None]}})
    speak = Action("speak", "speak", NONE)
    nodes = (
        Node("a", 0, position=place(0.0)),
        Node("b", 2, position=place(1.0, theta=0.0), actions=(lift,)),
        Node("c", 4, position=place(2.0)),
        Node("d", 6, released=False, position=place(3.0)),
    )
    edges = (
        Edge("ab", 1, "a", "b", actions=(speak,)),
        Edge("bc", 3, "b", "c", max_speed=0.5),
        Edge("cd", 5, "c", "d", released=False),
    )
    return VehicleOrder("order", 3, nodes, edges)


def restarted(machine: OrderMachine) -> OrderMachine:
    """Return a machine that has only what JSON has kept of the other one."""
    memory = from_plain(OrderMemory, json.loads(to_json(machine.memory)))
    assert memory == machine.memory
    after = OrderMachine()
    after.restore(memory)
    return after


def started() -> OrderMachine:
    machine = OrderMachine()
    machine.moved(here(0.0))
    machine.receive(an_order())
    return machine


def test_an_action_that_ran_has_failed_and_stops_the_order_if_it_forbids_driving() -> None:
    machine = started()
    machine.poll()
    machine.action_changed("speak", ActionStatus.FINISHED)
    machine.drive_ended("")
    assert [type(each) for each in machine.poll()] == [Perform]
    after = restarted(machine)
    after.moved(here(1.0))
    assert after.poll() == []
    assert {each.id: each.status for each in after.status.actions}["lift"] is ActionStatus.FAILED
    assert after.error is not None
    assert after.error.type == ErrorType.INTERRUPTED.value


def test_a_triggered_action_starts_only_where_its_node_is() -> None:
    machine = started()
    machine.poll()
    machine.action_changed("speak", ActionStatus.FINISHED)
    machine.drive_ended("")
    after = restarted(machine)  # the action has not been commanded yet
    assert after.poll() == []  # the position is not known yet
    after.moved(here(5.0))
    assert after.poll() == []
    assert after.error is not None
    again = restarted(machine)
    again.moved(here(1.0))
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
        from_plain(OrderMemory, data)


class SavedIds:
    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}

    def save(self, numbers: Mapping[str, int]) -> None:
        self.numbers = dict(numbers)


def test_no_header_id_is_used_twice_whenever_the_program_ends() -> None:
    saved, used = SavedIds(), []
    for _ in range(5):
        ids = HeaderIds(saved.numbers, saved.save)
        for _ in range(1500):
            number = ids.next("state")
            assert number < saved.numbers["state"]
            used.append(number)
    assert used == sorted(set(used))


def test_after_an_orderly_end_the_header_ids_have_no_gap() -> None:
    saved = SavedIds()
    ids = HeaderIds(saved.numbers, saved.save)
    assert [ids.next("state") for _ in range(3)] == [0, 1, 2]
    ids.close()
    assert HeaderIds(saved.numbers, saved.save).next("state") == 3


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
