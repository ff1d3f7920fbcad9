"""The simulated chassis answers every request of the schema that goes to a robot."""

from __future__ import annotations

from tests.simulator.sim_wire import JsonClient
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.pb.map import map_edit_pb2, map_pack_pb2, storage_edit_pb2
from woosh_robot_agent.pb.robot import (
    robot_count_pb2,
    robot_pack_pb2,
    robot_pb2,
    robot_setting_pb2,
)
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.simulator.protocol.reports import TOPICS

FILES = (
    map_edit_pb2,
    map_pack_pb2,
    storage_edit_pb2,
    robot_count_pb2,
    robot_pack_pb2,
    robot_pb2,
    robot_setting_pb2,
    ros_pack_pb2,
    woosh_task_pb2,
)
"""The files of the schema that have requests to a robot. Other files have parts of messages, and
messages of the dispatch system and of devices beside the robot."""

NO_REQUESTS = {
    # Answers
    "woosh.map.DownloadResponse",
    "woosh.map.SceneMd5Response",
    "woosh.map.SceneSyncResponse",
    "woosh.robot.CountDataResponse",
    "woosh.robot.DeploymentResponse",
    # Parts of other messages
    "woosh.map.SceneFileMD5",
    "woosh.robot.count.Abnormals",
    "woosh.robot.count.Operations",
    "woosh.robot.count.Statuses",
    "woosh.robot.count.Tasks",
    "woosh.ros.Feedback",
    "woosh.task.CallInfo",
    "woosh.task.CallTask",
    "woosh.task.TaskInfo",
    "woosh.task.WooshTask",
    "woosh.task.WooshTaskSet",
    # Requests to a dispatch system, which keeps task sets of many robots
    "woosh.task.AddTask",
    "woosh.task.InsertTask",
    # Pushed by robots with a beacon receiver, which this one has not
    "woosh.robot.BeaconData",
}
"""Messages of these files that are not requests to a robot."""

REQUESTS = sorted(
    {each.full_name for file in FILES for each in file.DESCRIPTOR.message_types_by_name.values()}
    - NO_REQUESTS
    | {"woosh.device.RfRemoteController"}
)

SUBSCRIPTIONS = (
    "woosh.device.RfRemoteController",
    "woosh.robot.Battery",
    "woosh.robot.BuildMapData",
    "woosh.robot.DeviceState",
    "woosh.robot.HardwareState",
    "woosh.robot.Mode",
    "woosh.robot.Model",
    "woosh.robot.NavPath",
    "woosh.robot.Network",
    "woosh.robot.OperationState",
    "woosh.robot.PoseSpeed",
    "woosh.robot.RobotState",
    "woosh.robot.ScannerData",
    "woosh.robot.Scene",
    "woosh.robot.Setting",
    "woosh.robot.TaskProc",
    "woosh.robot.count.AbnormalCodes",
    "woosh.robot.count.Operation",
    "woosh.robot.count.Status",
    "woosh.robot.count.StatusCode",
    "woosh.robot.count.Task",
    "woosh.ros.Feedbacks",
)
"""Everything that the manufacturer's own client can subscribe to."""


def test_no_request_is_refused_as_unknown(client: JsonClient) -> None:
    for name in REQUESTS:
        answer = client.request(name)
        unknown = answer["type"] == "error" or answer["msg"].startswith("unknown message type")
        assert not unknown, answer
        assert answer["ok"] or (answer["type"], answer["body"]) == (name, {})
        assert answer["ok"] or answer["msg"], name


def test_each_message_of_the_schema_is_classified() -> None:
    assert set(message_types()) >= {*REQUESTS, *NO_REQUESTS, *SUBSCRIPTIONS}


def test_everything_that_clients_subscribe_to_is_pushed() -> None:
    assert set(SUBSCRIPTIONS) <= TOPICS
