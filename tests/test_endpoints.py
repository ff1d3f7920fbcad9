"""The table of endpoints covers the schema: each request to a robot has an endpoint."""

from __future__ import annotations

from collections import Counter

from woosh_robot_agent.endpoints import (
    ACTIONS,
    AGENT_INFO,
    COMMANDS,
    OWN_READS,
    QUERIES,
    TOPICS,
    markdown,
)
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.pb.map import map_pack_pb2, storage_edit_pb2
from woosh_robot_agent.pb.robot import robot_pack_pb2, robot_setting_pb2
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task import woosh_task_pb2

FILES = (
    map_pack_pb2,
    storage_edit_pb2,
    robot_pack_pb2,
    robot_setting_pb2,
    ros_pack_pb2,
    woosh_task_pb2,
)
"""The parts of the schema that hold requests to a robot."""
NO_REQUESTS = {
    "woosh.map.DownloadResponse",
    "woosh.map.SceneFileMD5",
    "woosh.map.SceneMd5Response",
    "woosh.map.SceneSyncResponse",
    "woosh.robot.BuildMapData",
    "woosh.robot.CountDataResponse",
    "woosh.robot.DeploymentResponse",
    "woosh.ros.Feedback",
    "woosh.task.CallInfo",
    "woosh.task.CallTask",
    "woosh.task.TaskInfo",
    "woosh.task.WooshTask",
    "woosh.task.WooshTaskSet",
}
"""Answers, pushes and parts of other messages in these files."""
TO_A_DISPATCH_SERVER = {"woosh.task.AddTask", "woosh.task.InsertTask"}
"""Requests about task sets that wait for a robot, which only a dispatch server has."""
ANY_ACTION = "any_action"
"""Member of CallAction for commands that the schema does not describe."""


def test_each_request_to_a_robot_has_an_endpoint() -> None:
    found = {
        message.full_name
        for file in FILES
        for message in file.DESCRIPTOR.message_types_by_name.values()
    }
    requests = found - NO_REQUESTS - TO_A_DISPATCH_SERVER - set(OWN_READS)
    offered = {each.request for each in (*QUERIES, *COMMANDS)} | {"woosh.ros.CallAction"}
    assert requests <= offered, requests - offered
    assert found - offered >= NO_REQUESTS | TO_A_DISPATCH_SERVER


def test_each_command_of_call_action_has_an_endpoint() -> None:
    members = CallAction.DESCRIPTOR.oneofs_by_name["action"].fields
    offered = {each.member: each.arg for each in ACTIONS if each.member}
    assert offered == {
        each.name: each.message_type.full_name for each in members if each.name != ANY_ACTION
    }


def test_names_are_unique_and_types_exist() -> None:
    for table in ((*QUERIES, *COMMANDS), (*TOPICS, AGENT_INFO), ACTIONS):
        assert max(Counter(each.name for each in table).values()) == 1
    named = {each.request for each in (*QUERIES, *COMMANDS)}
    named |= {each.answer for each in COMMANDS if each.answer}
    named |= {each.push for each in TOPICS} | {each.arg for each in ACTIONS}
    assert named <= set(message_types())


def test_the_tables_mark_what_the_manufacturers_agent_lacks() -> None:
    names: dict[str, list[str]] = {}
    for table in markdown().split("### ")[1:]:
        kind, _, rows = table.partition("\n\n")
        names[kind] = [row.strip("|").split("|")[0].strip() for row in rows.splitlines()[2:] if row]
    assert sum(map(len, names.values())) == (
        sum(map(len, (QUERIES, COMMANDS, TOPICS, ACTIONS))) + 1
    )
    assert {"map/SceneList\\*", "robot/Mode"} <= {*names["Queries"]}
    assert {"map/Upload\\*", "robot/ExecPreTask"} <= {*names["Commands"]}
    assert {"robot/BuildMapData\\*", "robot/Mode", AGENT_INFO.name} <= {*names["Topics"]}
    assert {"robot/ExecPreTask\\*", "ros/MoveBase"} <= {*names["Actions"]}
