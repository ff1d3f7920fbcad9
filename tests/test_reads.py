"""Every request in the agent's table is classified: it only reads, or it may change something."""

from __future__ import annotations

import pytest
from google.protobuf.message import Message

from tests.motion.moving import MOVING, name_of
from tests.motion.test_requests import COMMAND_MOTION, MOVE_NOTHING, RESTING
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, OWN_READS, QUERIES
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.pb.robot.robot_pack_pb2 import CountData, RobotWiFi

READING_COMMANDS = {
    "woosh.map.Download",
    "woosh.map.SceneData",
    "woosh.map.SceneMd5",
    "woosh.map.SceneSync",
    "woosh.map.mark.storage.Find",
    "woosh.map.mark.storage.Storages",
    "woosh.robot.CountData",
    "woosh.robot.PlanNavPath",
    "woosh.robot.ScannerData",
}


def test_each_command_of_the_table_is_classified() -> None:
    """Set `reads` in the table for a new command that only reads, and add it here."""
    commands = {command.request for command in COMMANDS}
    assert {name for name in commands if only_reads(message_type(name)())} == READING_COMMANDS
    assert commands >= READING_COMMANDS


def test_queries_and_the_agents_own_requests_read() -> None:
    for name in (*(query.request for query in QUERIES), *OWN_READS):
        assert only_reads(message_type(name)()), name


def test_no_action_reads() -> None:
    for action in ACTIONS:
        name = "woosh.ros.CallAction" if action.member else action.arg
        assert not only_reads(message_type(name)()), name


@pytest.mark.parametrize("request_", [*MOVING, *RESTING], ids=name_of)
def test_whatever_commands_motion_does_not_read(request_: Message) -> None:
    assert not only_reads(request_)


def test_whatever_else_is_no_query_does_not_read() -> None:
    changing = (COMMAND_MOTION | MOVE_NOTHING) - READING_COMMANDS
    for name in (*changing, "woosh.map.Delete", "woosh.map.Upload", "woosh.robot.BuildMap"):
        assert not only_reads(message_type(name)()), name


@pytest.mark.parametrize(
    ("request_", "reads"),
    [
        (RobotWiFi(order=RobotWiFi.kWiFiList), True),
        (RobotWiFi(order=RobotWiFi.kWiFiList, content=b"x"), False),
        (RobotWiFi(), False),
        *((RobotWiFi(order=order), False) for order in range(2, 7)),
    ],
)
def test_of_the_wifi_orders_only_the_list_reads(request_: RobotWiFi, reads: bool) -> None:
    assert only_reads(request_) is reads


@pytest.mark.parametrize(("req_type", "reads"), [(CountData.kGet, True), (CountData.kSync, False)])
def test_statistics_are_read_but_not_synchronised(req_type: CountData.Type, reads: bool) -> None:
    assert only_reads(CountData(req_type=req_type)) is reads
