"""Status of the link."""

from __future__ import annotations

import time

from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.standard.diagnostics.status import ERROR, OK, Status


def link_status(chassis: ChassisClient, superseded: int, held: tuple[float, float]) -> Status:
    """Return the status of the link: its state, and counters of traffic and losses.

    Args:
        chassis: the link.
        superseded: number of velocities that were not sent because they were out of date.
        held: see `LoopThread.held`.
    """
    stats, status = chassis.stats, Status("link")
    if chassis.state is not LinkState.READY:
        why = f": {chassis.last_error}" if chassis.last_error else ""
        status.tell(ERROR, f"{chassis.state.value}{why}")
    observes_only = bool(chassis.refusal(Twist()))
    if observes_only:
        status.tell(OK, "observes only: commands are refused")
    round_trip = "unknown" if stats.round_trip is None else f"{stats.round_trip * 1000:.1f} ms"
    status.values = {
        "state": chassis.state.value,
        "address": chassis.config.address,
        "observe only": "yes" if observes_only else "no",
        "since": time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(chassis.since)),
        "reconnects": max(stats.connects - 1, 0),
        "round trip": round_trip,
        "rx": stats.rx,
        "tx": stats.tx,
        "parse errors": sum(stats.bad_frames.values()),
        "drops": sum(stats.dropped_pushes.values()),
        "refused requests": sum(stats.refused_requests.values()),
        "superseded velocities": superseded,
        "link thread held": f"{held[0] * 1000:.1f} ms, {held[1] * 1000:.1f} ms since the start",
        "timeouts": sum(stats.timeouts.values()),
        "late answers": stats.late_answers,
    }
    for what, counter in (
        ("parse errors", stats.bad_frames),
        ("drops", stats.dropped_pushes),
        ("refused requests", stats.refused_requests),
        ("timeouts", stats.timeouts),
    ):
        status.values.update({f"{what}: {kind}": count for kind, count in counter.items()})
    return status
