"""Handler of PlanNavPath, which plans a path without driving it."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import navigation_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.route import NoRouteError, plan_route
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result, pose
from woosh_robot_agent.simulator.protocol.reports import pose2d
from woosh_robot_agent.simulator.refusals import RefusedError


def _plan_nav_path(chassis: Chassis, request: pack.PlanNavPath) -> Result:
    if not request.HasField("end"):
        raise RefusedError(refusals.NO_END)
    if request.tolerance < 0.0:
        raise RefusedError(refusals.NEGATIVE_TOLERANCE, tolerance=request.tolerance)
    start, end = pose(request.start), pose(request.end)
    if not request.HasField("start"):
        chassis.readiness.require_located()
        start = chassis.pose
    for each in (start, end):
        chassis.require_room(each)
    try:
        route = plan_route(chassis, start, [end])
    except NoRouteError as error:
        raise RefusedError(refusals.NO_PATH, failure=error) from None
    detour = route.length - start.distance(end.point)
    if request.tolerance and detour > request.tolerance:
        raise RefusedError(refusals.DETOUR_TOO_LONG, detour=detour, limit=request.tolerance)
    path = navigation_pb2.Path(poses=map(pose2d, route.poses))
    return robot_pb2.NavPath(robot_id=chassis.robot_id, path=path)


HANDLERS: Handlers = {pack.PlanNavPath: _plan_nav_path}
