"""Client for a recording without an agent: subscribes to everything, commands nothing."""

from __future__ import annotations

import asyncio
import logging

from woosh_robot_agent.endpoints import QUERIES, TOPICS
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkError, LinkState
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.requests import RequestMaker

_LOG = logging.getLogger(__name__)


class PassiveClient:
    """A client that subscribes to all pushes and sends each query once per connection.

    It discards what it receives, because the proxy records it.

    Args:
        config: Address of the proxy.
    """

    def __init__(self, config: LinkConfig) -> None:
        self._chassis = ChassisClient(config=config)
        for topic in TOPICS:
            if not topic.on_demand:
                self._chassis.subscribe(message_type(topic.push), _discard)
        self._chassis.subscribe(Feedbacks, _discard)
        self._chassis.on_state(self._on_state)
        self._queries: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Connect, and reconnect whenever the connection is lost."""
        self._chassis.start()

    async def close(self) -> None:
        """Disconnect."""
        self._cancel_queries()
        await self._chassis.close()

    def _on_state(self, state: LinkState) -> None:
        self._cancel_queries()
        if state is LinkState.READY:
            self._queries = asyncio.get_running_loop().create_task(self._query_all())

    def _cancel_queries(self) -> None:
        if self._queries is not None:
            self._queries.cancel()

    async def _query_all(self) -> None:
        """Send each query, so that the replayed chassis can answer it."""
        requests = RequestMaker(self._chassis.config.robot_id)
        for name in dict.fromkeys(query.request for query in QUERIES):
            try:
                await self._chassis.request(requests.empty(message_type(name)))
            except LinkError as error:
                _LOG.info("query %s failed: %s", name, error)


def _discard(_message: object) -> None:
    pass
