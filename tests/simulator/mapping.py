"""Making maps in tests: driving by velocities, and the requests of a client that makes a map."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from tests.simulator.recorded_chassis import Frame, SteppedChassis, ask
from tests.simulator.sim_wire import Json

BUILD_MAP, BUILD_MAP_DATA = "woosh.robot.BuildMap", "woosh.robot.BuildMapData"
DEPLOYMENT, SCENE = "woosh.robot.Deployment", "woosh.robot.Scene"
INIT_ROBOT, STATE = "woosh.robot.InitRobot", "woosh.robot.RobotState"
SWITCH_MAP, SWITCH_WORK_MODE = "woosh.robot.SwitchMap", "woosh.robot.SwitchWorkMode"
TWIST = "woosh.robot.Twist"
ADD, UPDATE, CANCEL, SAVE = 1, 2, 3, 4
DEPLOYMENT_MODE, TASK_MODE = 1, 2

_SPEED, _TURN_RATE = 0.8, 0.8


def start_mapping(
    chassis: SteppedChassis, kind: int = ADD, scene: str = "new", area: str = "hall"
) -> Frame:
    """Switch to deployment mode and start to make a map, or to update one."""
    ask(chassis, SWITCH_WORK_MODE, mode=DEPLOYMENT_MODE)
    return ask(chassis, BUILD_MAP, type=kind, sceneName=scene, mapName=area)


def save_map(chassis: SteppedChassis) -> Frame:
    return ask(chassis, BUILD_MAP, type=SAVE)


def use_map(chassis: SteppedChassis) -> None:
    """Do what a client does after it has saved a map, so that the robot accepts tasks."""
    ask(chassis, SWITCH_MAP, sceneName="new", mapName="hall")
    ask(chassis, INIT_ROBOT, isRecord=True)
    ask(chassis, SWITCH_WORK_MODE, mode=TASK_MODE)
    chassis.run(0.2)


def drive(chassis: SteppedChassis, *places: Sequence[float]) -> None:
    """Drive to each place in turn by velocities, straight ahead."""
    base = chassis.chassis.base
    for place in places:
        point = (place[0], place[1])
        for _ in range(1000):
            bearing = base.pose.bearing(point)
            if base.pose.distance(point) < 0.2:
                break
            if abs(bearing) > 0.2:
                chassis.request(TWIST, angular=math.copysign(_TURN_RATE, bearing))
            else:
                chassis.request(TWIST, linear=_SPEED, angular=bearing)
            chassis.run(0.2)
            assert not base.blocked, f"blocked at {base.pose} on the way to {point}"
        else:
            raise AssertionError(f"did not come to {point}, but to {base.pose}")
    chassis.request(TWIST)
    chassis.run(0.5)


def turn_around(chassis: SteppedChassis, seconds: float = 9.0) -> None:
    """Turn on the spot, by default once round."""
    for _ in range(round(seconds / 0.2)):
        chassis.request(TWIST, angular=_TURN_RATE)
        chassis.run(0.2)
    chassis.request(TWIST)
    chassis.run(0.5)


def greys(png: bytes) -> npt.NDArray[Any]:
    """Return the pixels of a map picture, in rows by increasing y."""
    return np.asarray(Image.open(io.BytesIO(png)))[::-1]


def picture(body: Json) -> npt.NDArray[Any]:
    """Return the pixels of a BuildMapData, in rows by increasing y."""
    return greys(base64.b64decode(body["mapData"]))


def at(body: Json, pixels: npt.NDArray[Any], x: float, y: float) -> int:
    """Return the pixel of a BuildMapData at (x, y) in metres."""
    column = math.floor((x - body["originX"]) / body["resolution"])
    row = math.floor((y - body["originY"]) / body["resolution"])
    return int(pixels[row, column])
