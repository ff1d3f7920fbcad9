"""A scene: the maps of a site and the tasks that are defined there."""

from __future__ import annotations

from dataclasses import dataclass, field

from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map


@dataclass
class Scene:
    """The maps of a site and the tasks that are defined there.

    Attributes:
        name: Name, unique among the scenes.
        maps: At least one map. The first one is the default.
        files: Files that clients uploaded and that describe neither map, mark nor task, by name.
        start: Initial pose of the robot on `start_map`; None if the scene does not define one.
        start_map: Name of the map on which the robot starts; empty for the first one.
        predefined: Task sets that ExecPreTask can start.
        calls: Task sets that call buttons start.
    """

    name: str
    maps: list[Map]
    files: dict[str, bytes] = field(default_factory=dict)
    start: Pose | None = None
    start_map: str = ""
    predefined: woosh_task_pb2.RepeatTasks = field(default_factory=woosh_task_pb2.RepeatTasks)
    calls: woosh_task_pb2.CallTasks = field(default_factory=woosh_task_pb2.CallTasks)

    def map(self, name: str) -> Map | None:
        """Return the map called `name`, the first map if `name` is empty, or None."""
        if not name:
            return self.maps[0]
        return next((each for each in self.maps if each.name == name), None)
