"""Client for a recording without an agent: subscribes to everything, commands nothing."""

from __future__ import annotations

import asyncio
import logging

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import QUERIES, TOPICS
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkError, LinkState
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks

_LOG = logging.getLogger(__name__)


class PassiveClient:
    """A client that subscribes to all pushes and sends each query once per connection.

    It discards what it receives, because the proxy records it.

    Args:
        config: Address of the proxy.
        with_large: Subscribe also to large pushes: laser scans and growing maps.
    """

    def __init__(self, config: LinkConfig, *, with_large: bool = True) -> None:
        self._chassis = ChassisClient(config=config)
        self._chassis.on_snapshot(self._on_snapshot)
        self._scene = ""
        """Name of the scene, by which its map is requested."""
        for topic in TOPICS:
            if with_large or not topic.on_demand:
                self._chassis.subscribe_raw(message_type(topic.push), _discard)
        self._chassis.subscribe_raw(Feedbacks, _discard)
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

    def _on_snapshot(self, info: RobotInfo) -> None:
        self._scene = info.scene.scene_name

    def _cancel_queries(self) -> None:
        if self._queries is not None:
            self._queries.cancel()

    async def _query_all(self) -> None:
        """Send each query, so that the replayed chassis can answer it."""
        make = RequestMaker(self._chassis.config.robot_id)
        names = dict.fromkeys(query.request for query in QUERIES)
        requests = [make.empty(message_type(name)) for name in names]
        if self._scene:
            requests.append(make.address(SceneData(name=self._scene)))  # has the map
        for request in requests:
            try:
                await self._chassis.request(request)
            except LinkError as error:
                _LOG.info("query %s failed: %s", full_name(request), error)


def _discard(_message: object) -> None:
    pass
