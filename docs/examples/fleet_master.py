"""A small VDA 5050 master: sends vehicles round on a loop of nodes, at most one on each node.

    pip install aiomqtt
    python3 docs/examples/fleet_master.py --broker 127.0.0.1:1883

It finds the vehicles by their `connection` topics. Each vehicle gets one order, which begins where
it stands. A node is released to a vehicle, by an update of its order, as soon as no other vehicle
holds it. A vehicle holds the nodes that were released to it, until it has reached the next one.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import signal
import sys
import uuid
from collections.abc import Iterator
from datetime import datetime, timezone
from itertools import pairwise
from typing import Any

import aiomqtt

LOOP = (
    (4.0, -7.0),
    (9.0, -7.0),
    (10.4, -2.0),
    (6.5, 1.0),
    (7.0, 6.5),
    (2.0, 7.0),
    (-3.0, 3.5),
    (-8.0, 1.5),
    (-3.0, -1.0),
    (-2.5, -6.5),
)
"""Nodes of the loop in the simulated hall: x and y, in metres. The last one leads to the first."""
AHEAD = 2
"""Maximum number of nodes that are released ahead of a vehicle."""
INTERFACE = "uagv/v2"
"""First levels of the topics."""

Message = dict[str, Any]


class Vehicle:
    """What the master knows of a vehicle.

    Attributes:
        state: last `state` message; None before the first one.
        online: it is connected to the broker.
        base: released nodes from the last one that the vehicle has reached: sequenceId, number on
            the loop.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.manufacturer, self.serial = topic.split("/")[-2:]
        self.state: Message | None = None
        self.online = False
        self.base: list[tuple[int, int]] = []
        self.order_id = ""
        self.update_id = 0
        self.confirmed = False
        """True once the vehicle has reported the last order or update."""
        self.cancelled = False
        """True if it was told to cancel an order of somebody else."""
        self._header_ids = {"order": 0, "instantActions": 0}

    @property
    def ready(self) -> bool:
        """True if it can take orders."""
        state = self.state
        return (
            self.online
            and state is not None
            and state["operatingMode"] == "AUTOMATIC"
            and "agvPosition" in state
            and all(error["errorLevel"] != "FATAL" for error in state["errors"])
        )

    def message(self, topic: str, content: Message) -> tuple[str, str]:
        """Return the topic and the payload of a message to the vehicle."""
        now = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        head = {
            "headerId": self._header_ids[topic],
            "timestamp": now.replace("+00:00", "Z"),
            "version": "2.1.0",
            "manufacturer": self.manufacturer,
            "serialNumber": self.serial,
        }
        self._header_ids[topic] += 1
        return f"{self.topic}/{topic}", json.dumps(head | content)


class Master:
    """Decides what to send. It does not know the broker."""

    def __init__(self) -> None:
        self.vehicles: dict[str, Vehicle] = {}

    def receive(self, topic: str, message: Message) -> Iterator[tuple[str, str]]:
        """Take a message of a vehicle; yield the messages to send, with their topics."""
        place, _, name = topic.rpartition("/")
        vehicle = self.vehicles.setdefault(place, Vehicle(place))
        if name == "connection":
            vehicle.online = message["connectionState"] == "ONLINE"
            print(f"{vehicle.serial}: {message['connectionState']}", flush=True)
            if vehicle.online and vehicle.state is None:
                yield self._action(vehicle, "stateRequest")
        else:
            self._print_errors(vehicle, message)
            vehicle.state = message
            self._follow(vehicle)
        if any(each.online and each.state is None for each in self.vehicles.values()):
            return  # it is not known yet where this vehicle stands
        for each in self.vehicles.values():
            if each.ready:
                yield from self._release(each)

    def _print_errors(self, vehicle: Vehicle, message: Message) -> None:
        before = vehicle.state["errors"] if vehicle.state else []
        for error in message["errors"]:
            if error not in before:
                text = error.get("errorDescription", "")
                print(f"{vehicle.serial}: {error['errorType']}: {text}", flush=True)

    def _follow(self, vehicle: Vehicle) -> None:
        """Take over how far the vehicle is, and free the nodes that it has left."""
        state = vehicle.state
        assert state is not None
        if state["orderId"] == vehicle.order_id:
            vehicle.confirmed = state["orderUpdateId"] == vehicle.update_id
            reached = state["lastNodeSequenceId"]
            vehicle.base = [each for each in vehicle.base if each[0] >= reached]
        elif vehicle.confirmed:  # it was restarted, or somebody else gave it an order
            vehicle.order_id, vehicle.confirmed = "", False

    def _release(self, vehicle: Vehicle) -> Iterator[tuple[str, str]]:
        """Send an order, or release the next nodes, if nobody holds them."""
        state = vehicle.state
        assert state is not None
        if not vehicle.order_id:
            if state["nodeStates"] or state["edgeStates"]:  # it still executes another order
                if not vehicle.cancelled:
                    vehicle.cancelled = True
                    print(f"{vehicle.serial}: cancelling the order that it executes", flush=True)
                    yield self._action(vehicle, "cancelOrder")
                return
            vehicle.cancelled = False
            position = state["agvPosition"]
            vehicle.base = [(0, nearest(position["x"], position["y"]))]
            first = node(vehicle.base[0], position["x"], position["y"], position["mapId"])
        elif vehicle.confirmed:
            first = node(
                vehicle.base[-1], *LOOP[vehicle.base[-1][1]], state["agvPosition"]["mapId"]
            )
        else:
            return
        nodes = [first]
        while len(vehicle.base) <= AHEAD:
            sequence, number = vehicle.base[-1]
            following = (number + 1) % len(LOOP)
            if following in self._held(vehicle):
                break
            vehicle.base.append((sequence + 2, following))
            nodes.append(node(vehicle.base[-1], *LOOP[following], first["nodePosition"]["mapId"]))
        if len(nodes) > 1:
            yield self._order(vehicle, nodes)

    def _held(self, vehicle: Vehicle) -> set[int]:
        """Return the nodes that other vehicles hold."""
        return {
            number
            for other in self.vehicles.values()
            if other is not vehicle
            for number in [number for _, number in other.base] or standing(other)
        }

    def _order(self, vehicle: Vehicle, nodes: list[Message]) -> tuple[str, str]:
        vehicle.update_id = vehicle.update_id + 1 if vehicle.order_id else 0
        vehicle.order_id = vehicle.order_id or str(uuid.uuid4())
        vehicle.confirmed = False
        names = " ".join(each["nodeId"] for each in nodes[1:])
        print(f"{vehicle.serial}: released {names}", flush=True)
        content = {
            "orderId": vehicle.order_id,
            "orderUpdateId": vehicle.update_id,
            "nodes": nodes,
            "edges": [edge(start, end) for start, end in pairwise(nodes)],
        }
        return vehicle.message("order", content)

    def _action(self, vehicle: Vehicle, name: str) -> tuple[str, str]:
        action = {
            "actionId": str(uuid.uuid4()),
            "actionType": name,
            "blockingType": "HARD",
            "actionParameters": [],
        }
        return vehicle.message("instantActions", {"actions": [action]})


def nearest(x: float, y: float) -> int:
    """Return the number of the nearest node."""
    return min(range(len(LOOP)), key=lambda number: math.dist(LOOP[number], (x, y)))


def standing(vehicle: Vehicle) -> list[int]:
    """Return the node at which a vehicle without an order stands."""
    position = vehicle.state and vehicle.state.get("agvPosition")
    return [nearest(position["x"], position["y"])] if position else []


def node(place: tuple[int, int], x: float, y: float, map_id: str) -> Message:
    """Return a node of an order."""
    return {
        "nodeId": f"n{place[1] + 1}",
        "sequenceId": place[0],
        "released": True,
        "nodePosition": {"x": x, "y": y, "mapId": map_id},
        "actions": [],
    }


def edge(start: Message, end: Message) -> Message:
    """Return the edge between two nodes."""
    return {
        "edgeId": f"{start['nodeId']}-{end['nodeId']}",
        "sequenceId": start["sequenceId"] + 1,
        "released": True,
        "startNodeId": start["nodeId"],
        "endNodeId": end["nodeId"],
        "actions": [],
    }


def starts(count: int) -> Iterator[str]:
    """Yield poses on the loop, far from each other: x, y and heading."""
    for number in range(count):
        index = number * len(LOOP) // count
        (x, y), (to_x, to_y) = LOOP[index], LOOP[(index + 1) % len(LOOP)]
        yield f"{x}, {y}, {math.atan2(to_y - y, to_x - x):.3f}"


async def run(host: str, port: int) -> None:
    """Send the vehicles round until cancelled."""
    master = Master()
    async with aiomqtt.Client(host, port) as client:
        await client.subscribe([(f"{INTERFACE}/+/+/connection", 1), (f"{INTERFACE}/+/+/state", 0)])
        print(f"master ready at {host}:{port}", flush=True)
        async for message in client.messages:
            content = json.loads(bytes(message.payload))  # type: ignore[arg-type]
            for topic, payload in master.receive(message.topic.value, content):
                await client.publish(topic, payload)


async def run_until_stopped(host: str, port: int) -> None:
    """Run until SIGINT or SIGTERM. The vehicles drive to the end of what is released."""
    running = asyncio.ensure_future(run(host, port))
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await running


def main() -> int:
    """Run the master; return the exit status: 1 if the broker is lost."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--broker", default="127.0.0.1:1883", metavar="HOST:PORT")
    parser.add_argument(
        "--starts", type=int, metavar="N", help="print poses at which N vehicles can start, and end"
    )
    options = parser.parse_args()
    if options.starts is not None:
        print(*starts(options.starts), sep="\n")
        return 0
    host, _, port = options.broker.rpartition(":")
    try:
        asyncio.run(run_until_stopped(host, int(port)))
    except aiomqtt.MqttError as error:
        print(f"error: no connection to the broker at {options.broker}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
