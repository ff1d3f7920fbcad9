"""Classification of requests: those that only read, and those that may change or move something."""

from __future__ import annotations

from google.protobuf.message import Message

from woosh_robot_agent.endpoints import COMMANDS, OWN_READS, QUERIES
from woosh_robot_agent.pb.robot.robot_pack_pb2 import CountData, RobotWiFi
from woosh_robot_agent.protos import full_name

_READS = {
    *(query.request for query in QUERIES),
    *(command.request for command in COMMANDS if command.reads),
    *OWN_READS,
}
"""Protobuf full names of the requests that only read, whatever they contain."""


def only_reads(request: Message) -> bool:
    """Return True if a request changes and moves nothing; False if in doubt."""
    if isinstance(request, RobotWiFi):
        return request == RobotWiFi(order=RobotWiFi.kWiFiList)
    if isinstance(request, CountData):
        return request.req_type == CountData.kGet
    return full_name(request) in _READS
