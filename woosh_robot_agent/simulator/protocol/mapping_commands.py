"""Handlers of BuildMap, which makes maps, and Deployment, which collects points for them."""

from __future__ import annotations

from collections.abc import Sequence

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.deployment import CollectedPoint, PointKind
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import (
    Handlers,
    Result,
    pose,
    require_map_change,
)
from woosh_robot_agent.simulator.protocol.reports import pose2d
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.world.geometry import Pose

_KINDS: dict[int, PointKind] = {
    pack.kBeacons: PointKind.BEACON,
    pack.kArTags: PointKind.CODE,
    pack.kReflectors: PointKind.REFLECTOR,
    pack.kMark: PointKind.MARK,
}
"""Kinds of points by `woosh.robot.DeploymentType`."""


def _build_map(chassis: Chassis, request: pack.BuildMap) -> Result:
    mapping, kind = chassis.mapping, request.type
    if kind in (pack.BuildMap.kAdd, pack.BuildMap.kUpdate):
        require_map_change(chassis)
        start = mapping.add if kind == pack.BuildMap.kAdd else mapping.update
        duration = start(request.scene_name, request.map_name)
        chassis.deployment.end_session()
    elif kind == pack.BuildMap.kSave:
        duration = mapping.save()
    elif kind == pack.BuildMap.kCanel:
        new = mapping.draft is not None
        duration = mapping.cancel()
        if new:
            chassis.deployment.end_session()  # its points went with the map
        else:
            chassis.deployment.cancel_all()
    else:
        raise RefusedError(refusals.UNKNOWN_BUILD_TYPE, type=kind)
    # The answer comes when it is done.
    chassis.answer_delay = duration
    return None


def _deployment(chassis: Chassis, request: pack.Deployment) -> Result:
    kind, mode = request.type, request.mode
    if request.robot_id not in (0, chassis.robot_id):
        raise RefusedError(refusals.OTHER_ROBOT, robot_id=request.robot_id, own_id=chassis.robot_id)
    if kind not in _KINDS and (kind or mode == pack.kDepCollect):
        raise RefusedError(refusals.UNKNOWN_DEPLOYMENT_TYPE, type=kind)
    found: Sequence[CollectedPoint] = []
    if mode == pack.kDepCollect:
        where = pose(request.pose)
        # Some clients send an empty pose if they mean that of the robot.
        given = request.HasField("pose") and where != Pose()
        found = [chassis.deployment.collect(_KINDS[kind], where if given else None)]
    elif mode == pack.kDepCancel:
        chassis.deployment.cancel([_KINDS[kind]] if kind else list(PointKind))
    elif mode == pack.kDepReflector:
        if kind not in (pack.kDeploymentTypeUndefined, pack.kReflectors):
            raise RefusedError(refusals.ONLY_REFLECTORS)
        found = chassis.deployment.calibrate()
    else:
        raise RefusedError(refusals.UNKNOWN_DEPLOYMENT_MODE, mode=mode)
    markers = [pack.DeploymentResponse.Marker(id=each.id, pose=pose2d(each.pose)) for each in found]
    return pack.DeploymentResponse(
        type=kind, mode=mode, markers=markers, check_times=1 if markers else 0
    )


HANDLERS: Handlers = {pack.BuildMap: _build_map, pack.Deployment: _deployment}
