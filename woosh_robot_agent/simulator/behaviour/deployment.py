"""Deployment: marks, beacons, codes and reflectors that are collected with the robot."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from enum import Enum
from typing import NamedTuple

from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.mapping import Mapping
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map, Mark


class PointKind(Enum):
    """Kind of a collected point. The value is its list in `woosh.map.mark.MarkInfo`."""

    BEACON = "beacons"
    CODE = "artags"
    REFLECTOR = "reflectors"
    MARK = "storages"


class CollectedPoint(NamedTuple):
    """A collected point.

    Attributes:
        kind: Its kind.
        id: Identifier, unique among the points of this kind in its map.
        pose: Pose, in the map's frame.
    """

    kind: PointKind
    id: int
    pose: Pose


class Deployment:
    """Collects points for the current map, or for the new one that is being made.

    Points can be cancelled until the session ends: until a mapping starts, or the robot leaves
    deployment mode or the map.

    Args:
        robot: The robot.
        mapping: Makes new maps.
    """

    def __init__(self, robot: Robot, mapping: Mapping) -> None:
        self._robot = robot
        self._mapping = mapping
        self._collected: list[CollectedPoint] = []
        """Points of this session, in order."""

    def collect(self, kind: PointKind, pose: Pose | None) -> CollectedPoint:
        """Add a point to the map and return it.

        Args:
            kind: Its kind.
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
        point = CollectedPoint(kind, _free_id(area, kind), pose)
        self._change(_with(area, point))
        self._collected.append(point)
        return point

    def cancel(self, kinds: Collection[PointKind]) -> None:
        """Remove the points of some kinds that were collected in this session.

        Raises:
            RefusedError: The robot is not ready to collect.
        """
        self._require_ready()
        self._remove(kinds)

    def cancel_all(self) -> None:
        """Remove all points that were collected in this session."""
        self._remove(list(PointKind))

    def calibrate(self) -> list[CollectedPoint]:
        """Return the reflectors of the map. The robot finds all of them where they are.

        Raises:
            RefusedError: The robot is not ready, or the map has no reflectors.
        """
        self._require_ready()
        found = [
            CollectedPoint(
                PointKind.REFLECTOR, each.id, Pose(each.pose.x, each.pose.y, each.pose.theta)
            )
            for each in self._area.other_marks.reflectors
        ]
        if not found:
            raise RefusedError(refusals.NO_REFLECTORS, map=self._area.name)
        return found

    def end_session(self) -> None:
        """Keep the points: they can no longer be cancelled."""
        self._collected.clear()

    @property
    def _area(self) -> Map:
        return self._mapping.draft or self._robot.map

    def _change(self, area: Map) -> None:
        if self._mapping.draft:
            self._mapping.draft = area
        else:
            self._robot.change_map(dataclasses.replace(area, version=area.version + 1))

    def _remove(self, kinds: Collection[PointKind]) -> None:
        removed = [each for each in self._collected if each.kind in kinds]
        self._collected = [each for each in self._collected if each.kind not in kinds]
        if removed:
            self._change(_without(self._area, removed))

    def _require_ready(self) -> None:
        readiness = self._robot.readiness
        if readiness.work != util_robot_pb2.kDeployMode:
            raise RefusedError(refusals.COLLECTING_OUTSIDE_DEPLOYMENT)
        self._mapping.require_settled()
        if not readiness.located:
            raise RefusedError(refusals.LOCALISATION_LOST)


def _free_id(area: Map, kind: PointKind) -> int:
    if kind is not PointKind.MARK:
        return max((each.id for each in getattr(area.other_marks, kind.value)), default=0) + 1
    number = max((mark.id for mark in area.marks.values()), default=0) + 1
    while str(number) in area.marks:
        number += 1
    return number


def _with(area: Map, point: CollectedPoint) -> Map:
    """Return a map with one more point."""
    if point.kind is PointKind.MARK:
        mark = _mark(point)
        return dataclasses.replace(area, marks={**area.marks, mark.number: mark})
    others = _copy(area.other_marks)
    entry = getattr(others, point.kind.value).add(id=point.id)
    if point.kind is PointKind.BEACON:
        entry.point.x, entry.point.y = point.pose.point
    else:
        entry.pose.x, entry.pose.y, entry.pose.theta = point.pose.x, point.pose.y, point.pose.theta
    return dataclasses.replace(area, other_marks=others)


def _without(area: Map, points: Collection[CollectedPoint]) -> Map:
    """Return a map without some points. Marks that a client has changed since then stay."""
    gone = {(point.kind, point.id) for point in points}
    as_made = [_mark(point) for point in points if point.kind is PointKind.MARK]
    marks = {number: mark for number, mark in area.marks.items() if mark not in as_made}
    others = _copy(area.other_marks)
    for kind in (PointKind.BEACON, PointKind.CODE, PointKind.REFLECTOR):
        entries = getattr(others, kind.value)
        kept = [each for each in entries if (kind, each.id) not in gone]
        del entries[:]
        entries.extend(kept)
    return dataclasses.replace(area, marks=marks, other_marks=others)


def _mark(point: CollectedPoint) -> Mark:
    # The answer has only the id: clients must know by it the number that tasks name.
    return Mark(point.id, str(point.id), point.pose)


def _copy(marks: mark_pb2.MarkInfo) -> mark_pb2.MarkInfo:
    copy = mark_pb2.MarkInfo()
    copy.CopyFrom(marks)
    return copy
