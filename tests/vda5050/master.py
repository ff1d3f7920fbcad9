"""A master control for one vehicle, made with another MQTT library than the connector."""

from __future__ import annotations

import itertools
import json
import time
import uuid
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import gmqtt

from tests.asynchronous import eventually
from woosh_robot_agent.vda5050.messages.versions import timestamp

Message = dict[str, Any]
START = (4.23276472, -6.6727581)
"""Where a simulated robot stands at first; the hall is free to the east of it."""


def header(version: str = "2.1.0", serial: str = "30001", header_id: int = 0) -> Message:
    """The fields with which each message begins."""
    return {
        "headerId": header_id,
        "timestamp": timestamp(time.time()),
        "version": version,
        "manufacturer": "Woosh",
        "serialNumber": serial,
    }


class Master:
    """Sends orders to one vehicle, and stores what it reports."""

    def __init__(self, port: int, serial: str = "30001", version: str = "2.1.0") -> None:
        self._port = port
        self._serial = serial
        self._version = version
        self._prefix = f"uagv/v{version.split('.')[0]}/Woosh/{serial}/"
        self._client = gmqtt.Client(f"master-{uuid.uuid4()}")
        self._client.on_message = self._received
        self._header_ids = itertools.count()
        self.received: dict[str, list[Message]] = {}

    async def __aenter__(self) -> Master:
        await self._client.connect("127.0.0.1", self._port, version=gmqtt.constants.MQTTv311)
        self._client.subscribe(f"{self._prefix}#", qos=1)
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._client.disconnect()

    async def _received(
        self, client: Any, topic: str, payload: bytes, qos: int, properties: Any
    ) -> int:
        name = topic.removeprefix(self._prefix)
        if name in ("order", "instantActions"):  # our own messages
            return 0
        self.received.setdefault(name, []).append(json.loads(payload))
        return 0

    def last(self, topic: str) -> Message:
        """Last message on a topic; empty if there was none."""
        messages = self.received.get(topic)
        return messages[-1] if messages else {}

    @property
    def state(self) -> Message:
        return self.last("state")

    async def wait_state(self, condition: Callable[[Message], Any], what: str = "") -> Message:
        """Wait until the last state fulfils a condition."""

        def holds() -> Any:
            return self.state and condition(self.state)

        await eventually(holds, what or str(condition))
        return self.state

    async def online(self) -> None:
        """Wait until the vehicle is online and has reported its state."""
        await eventually(lambda: self.last("connection").get("connectionState") == "ONLINE")
        await eventually(lambda: self.state)

    async def status(self, action_id: str, status: str) -> Message:
        """Wait until an action has a status."""
        return await self.wait_state(
            lambda state: status_of(state, action_id) == status, f"{action_id} {status}"
        )

    async def reached(self, node_id: str) -> Message:
        """Wait until the last node is this one."""
        return await self.wait_state(lambda state: state["lastNodeId"] == node_id, node_id)

    async def accepted(self, order_id: str = "order") -> Message:
        """Wait until the vehicle has an order."""
        return await self.wait_state(lambda state: state["orderId"] == order_id, order_id)

    async def error(self, kind: str) -> Message:
        """Wait until the state has an error of a type."""
        return await self.wait_state(lambda state: kind in error_types(state), kind)

    def send(self, topic: str, content: Message) -> None:
        """Send a message with a header."""
        head = header(self._version, self._serial, next(self._header_ids))
        self.send_raw(topic, json.dumps(head | content).encode())

    def send_raw(self, topic: str, payload: bytes) -> None:
        self._client.publish(f"{self._prefix}{topic}", payload, qos=0)

    def order(
        self,
        nodes: Sequence[Message],
        edges: Sequence[Message] | None = None,
        *,
        order_id: str = "order",
        update: int = 0,
    ) -> None:
        """Send an order; without edges, plain ones connect the nodes."""
        content = {
            "orderId": order_id,
            "orderUpdateId": update,
            "nodes": list(nodes),
            "edges": plain_edges(nodes) if edges is None else list(edges),
        }
        self.send("order", content)

    async def order_until_accepted(self, nodes: Sequence[Message]) -> None:
        """Send an order until it is accepted, once the vehicle knows the marks at its nodes."""

        def is_accepted() -> bool:
            self.order(nodes)
            return bool(self.state["orderId"])

        await eventually(is_accepted)

    def instant(self, *actions: Message) -> None:
        """Send instant actions; in version 3 their blocking type is always NONE."""
        fixed = {"blockingType": "NONE"} if self._version.startswith("3") else {}
        self.send("instantActions", {"actions": [each | fixed for each in actions]})


def node(
    name: str,
    sequence: int,
    x: float,
    y: float,
    *,
    released: bool = True,
    actions: Sequence[Message] = (),
    map_id: str = "wooshmap",
    **position: Any,
) -> Message:
    return {
        "nodeId": name,
        "sequenceId": sequence,
        "released": released,
        "nodePosition": {"x": x, "y": y, "mapId": map_id, **position},
        "actions": list(actions),
    }


def edge(start: Message, end: Message, *, actions: Sequence[Message] = (), **more: Any) -> Message:
    """An edge between two nodes, released if its end is."""
    return {
        "edgeId": f"{start['nodeId']}-{end['nodeId']}",
        "sequenceId": start["sequenceId"] + 1,
        "released": end["released"],
        "startNodeId": start["nodeId"],
        "endNodeId": end["nodeId"],
        "actions": list(actions),
        **more,
    }


def plain_edges(nodes: Sequence[Message]) -> list[Message]:
    return [edge(start, end) for start, end in pairwise(nodes)]


def action(kind: str, name: str = "", *, blocking: str = "HARD", **parameters: Any) -> Message:
    return {
        "actionId": name or str(uuid.uuid4()),
        "actionType": kind,
        "blockingType": blocking,
        "actionParameters": [{"key": key, "value": value} for key, value in parameters.items()],
    }


def action_state(state: Message, action_id: str) -> Message:
    """The part of a state about an action; empty if it is not there."""
    states: list[Message] = state["actionStates"]
    return next((each for each in states if each["actionId"] == action_id), {})


def status_of(state: Message, action_id: str) -> str:
    return str(action_state(state, action_id).get("actionStatus", ""))


def result_of(state: Message, action_id: str) -> str:
    return str(action_state(state, action_id).get("resultDescription", ""))


def error_types(state: Message) -> list[str]:
    return [each["errorType"] for each in state["errors"]]


def nodes_left(state: Message) -> str:
    """Ids of the nodes still to be reached, without separators."""
    return "".join(each["nodeId"] for each in state["nodeStates"])


def references(error: Message) -> dict[str, str]:
    return {each["referenceKey"]: each["referenceValue"] for each in error["errorReferences"]}
