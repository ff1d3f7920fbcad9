"""Deployment: marks and markers that are collected with the robot."""

from __future__ import annotations

import dataclasses

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.mapping import Mapping
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map, Mark, Marker, MarkerKind


class Deployment:
    """Collects marks and markers for the current map, or for the new one that is being made.

    Args:
        robot: The robot.
        mapping: Makes new maps.
    """

    def __init__(self, robot: Robot, mapping: Mapping) -> None:
        self._robot = robot
        self._mapping = mapping
        self._collected: list[Mark | Marker] = []

    def collect(self, kind: MarkerKind | None, pose: Pose | None) -> Mark | Marker:
        """Add a mark or marker to the map and return it.

        Args:
            kind: Kind of the marker; None for a mark.
            pose: Its pose; None for that of the robot.

        Raises:
            RefusedError: The robot is not ready to collect, or the pose is outside the map.
        """
        self._require_ready()
        area = self._area
        if pose is None:
            pose = self._robot.base.pose
        elif area is not self._mapping.draft and not area.contains(*pose.point):
            raise RefusedError(refusals.POSE_OUTSIDE_MAP, pose=pose, map=area.name)
        if kind is None:
            mark = self._new_mark(area, pose)
            self._change(dataclasses.replace(area, marks={**area.marks, mark.number: mark}))
            self._collected.append(mark)
            return mark
        number = max((each.id for each in area.markers if each.kind is kind), default=0) + 1
        marker = Marker(number, kind, pose)
        self._change(dataclasses.replace(area, markers=(*area.markers, marker)))
        self._collected.append(marker)
        return marker

    def cancel(self, kinds: tuple[MarkerKind | None, ...]) -> None:
        """Remove what was collected since the robot came into deployment mode or began to map.

        Args:
            kinds: Kinds of the markers to be removed; None stands for marks.

        Raises:
            RefusedError: The robot is not ready to collect.
        """
        self._require_ready()
        self._remove(kinds)

    def cancel_all(self) -> None:
        """Remove everything that was collected since the session began."""
        self._remove((None, *MarkerKind))

    def calibrate(self) -> list[Marker]:
        """Return the reflectors of the map, all of which the robot finds where they are.

        Raises:
            RefusedError: The robot is not ready, or the map has no reflectors.
        """
        self._require_ready()
        found = [each for each in self._area.markers if each.kind is MarkerKind.REFLECTOR]
        if not found:
            raise RefusedError(refusals.NO_REFLECTORS, map=self._area.name)
        return found

    def end_session(self) -> None:
        """Keep what was collected so far: it can no longer be cancelled."""
        self._collected.clear()

    @property
    def _area(self) -> Map:
        return self._mapping.draft or self._robot.map

    def _change(self, area: Map) -> None:
        if self._mapping.draft:
            self._mapping.draft = area
        else:
            self._robot.change_map(dataclasses.replace(area, version=area.version + 1))

    def _new_mark(self, area: Map, pose: Pose) -> Mark:
        """Return a mark whose number is its id, so that the answer is enough to name it."""
        number = max((mark.id for mark in area.marks.values()), default=0) + 1
        while str(number) in area.marks:
            number += 1
        return Mark(number, str(number), pose)

    def _remove(self, kinds: tuple[MarkerKind | None, ...]) -> None:
        area = self._area
        # By identity: what a client has changed since then stays, and so do equal ones elsewhere.
        removed = {id(each) for each in self._collected if _kind(each) in kinds}
        self._collected = [each for each in self._collected if _kind(each) not in kinds]
        marks = {key: mark for key, mark in area.marks.items() if id(mark) not in removed}
        markers = tuple(marker for marker in area.markers if id(marker) not in removed)
        if len(marks) < len(area.marks) or len(markers) < len(area.markers):
            self._change(dataclasses.replace(area, marks=marks, markers=markers))

    def _require_ready(self) -> None:
        readiness = self._robot.readiness
        if readiness.work != util_robot_pb2.kDeployMode:
            raise RefusedError(refusals.COLLECTING_OUTSIDE_DEPLOYMENT)
        self._mapping.require_settled()
        if not readiness.located:
            raise RefusedError(refusals.LOCALISATION_LOST)


def _kind(item: Mark | Marker) -> MarkerKind | None:
    return item.kind if isinstance(item, Marker) else None
