"""The topic keepout_mask: the areas that the robot's navigation keeps out of."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid
from PIL import Image

from tests.fact_files import FOLDER
from tests.harness import Client, Logs, RunningAgent
from tests.quick_chassis import quick_config
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.ros.standard import map as map_part
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_agent.simulator.protocol.reports import robot_info

pytestmark = pytest.mark.usefixtures("frequent")

SCENE = FOLDER / "real_scene"
SCENE_DATA = "woosh.map.SceneData"
StartAgent = Callable[..., RunningAgent]


@pytest.fixture
def office() -> Iterator[SimulatorThread]:
    """A robot in the real scene."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, seed=1, scenes=(SCENE,))) as running:
        yield running


def cells(grid: OccupancyGrid) -> np.ndarray[Any, np.dtype[np.int8]]:
    return np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width)


def test_mask_is_the_robots_picture(
    office: SimulatorThread, start_agent: StartAgent, client: Client
) -> None:
    start_agent(ip="127.0.0.1", port=office.port)
    mask = client.echo(OccupancyGrid, "keepout_mask").wait_count(1)[0]
    with Image.open(SCENE / "Wego_Robotics_503" / "keepout.png") as picture:
        black = np.asarray(picture.convert("L"))[::-1] == 0
    assert np.array_equal(cells(mask), np.where(black, 100, 0))
    area = client.echo(OccupancyGrid, "map").wait_count(1)[0]
    assert mask.info == area.info
    assert mask.header.frame_id == area.header.frame_id == "map"
    assert office.counts[SCENE_DATA] == 1


def test_map_without_keep_out_areas_has_an_empty_mask(agent: RunningAgent, client: Client) -> None:
    mask = client.echo(OccupancyGrid, "keepout_mask").wait_count(1)[0]
    area = client.echo(OccupancyGrid, "map").wait_count(1)[0]
    assert mask.info == area.info
    assert not cells(mask).any()


def test_a_map_that_costs_the_link_is_not_requested_at_once_again(
    office: SimulatorThread,
    start_agent: StartAgent,
    client: Client,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """E.g. a map that exceeds `max_frame_size`: most of the time, there would be no link."""
    monkeypatch.setattr(map_part, "_RETRY_DELAY", 3600.0)
    agent = start_agent(ip="127.0.0.1", port=office.port)
    office.mute(SCENE_DATA)
    client.echo(OccupancyGrid, "map")
    office.wait_received(SCENE_DATA)
    office.drop()
    agent.wait_connected(2)
    time.sleep(0.5)  # so long, ten checks would each request it
    assert office.counts[SCENE_DATA] == 1


def test_a_mask_that_cannot_be_read_forbids_the_whole_map(
    office: SimulatorThread, start_agent: StartAgent, client: Client, logs: Logs
) -> None:
    """The mask of the map before would permit to drive where this map forbids it."""

    def damage(frame: Outgoing) -> list[Outgoing]:
        if isinstance(frame.body, SceneData):
            frame.body.maps[0].keepout_png = b"no picture"
        return [frame]

    start_agent(ip="127.0.0.1", port=office.port)
    masks = client.echo(OccupancyGrid, "keepout_mask")
    assert not cells(masks.wait_count(1)[0]).all()
    office.intercept(damage)
    scene = office.call(lambda each: robot_info(each.chassis).scene)
    scene.version += 1
    office.push(scene)
    mask = masks.wait_count(2)[1]
    area = client.echo(OccupancyGrid, "map").wait(lambda each: each.header == mask.header)
    assert mask.info == area.info
    assert (cells(mask) == 100).all()
    assert logs.wait_text("keepout_mask forbids the whole map")


def test_each_reason_for_which_there_is_no_map_is_logged(
    office: SimulatorThread,
    start_agent: StartAgent,
    client: Client,
    logs: Logs,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(map_part, "_RETRY_DELAY", 0.0)
    office.refuse(SCENE_DATA, "the first reason")
    start_agent(ip="127.0.0.1", port=office.port)
    client.echo(OccupancyGrid, "map")
    logs.wait_text("no map: ", "the first reason", level="WARNING")
    office.refuse(SCENE_DATA, "the second reason")
    logs.wait_text("no map: ", "the second reason", level="WARNING")
