"""Concurrent calls: no call waits for another, and each gets exactly one answer."""

from __future__ import annotations

import random
import threading
from array import array
from dataclasses import replace
from typing import Any

import pytest
from nav2_msgs.srv import LoadMap
from std_srvs.srv import Trigger

from tests.harness import Logs, Robot, wait_future
from tests.node.goals import answer_with_json, replace_answers
from woosh_common_msgs.msg import FileData
from woosh_map_msgs.msg import Download as DownloadMsg
from woosh_map_msgs.msg import Upload as UploadMsg
from woosh_map_msgs.srv import Download, Upload
from woosh_robot_agent.pb.map.map_pack_pb2 import DownloadResponse
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath as NavPathProto
from woosh_robot_agent.ros.bridge import AgentStoppingError, Reply
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.srv import General, Mode, NavPath, SetSound, Speak, SwitchControlMode

SPEAK = "woosh.robot.Speak"
NAV_PATH = "woosh.robot.NavPath"


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that tests of this file share, and its new chassis."""
    return shared_robot


def speak(client: Any, text: str) -> Any:
    return client.call_async(Speak, "robot/Speak", arg=SpeakMsg(text=text))


def test_every_response_of_a_stopping_agent_says_why() -> None:
    sent: list[Any] = []
    for service in (Speak, Trigger, LoadMap):
        Reply(service.Response, lambda response, _: sent.append(response), None).fail(
            AgentStoppingError()
        )
    assert [sent[0].msg, sent[1].message] == 2 * ["the agent is stopping"]
    assert sent[2].result == LoadMap.Response.RESULT_UNDEFINED_FAILURE, "a blank one is a success"


def test_a_slow_call_holds_up_no_other(robot: Robot) -> None:
    robot.chassis.mute(SPEAK)
    slow = speak(robot, "slow")
    robot.chassis.wait_received(SPEAK)
    assert robot.call(SwitchControlMode, "robot/SwitchControlMode") is not None
    assert robot.call(Mode, "robot/Mode").info.ctrl.value == 1
    robot.chassis.accept(SPEAK)
    assert wait_future(speak(robot, "quick")).ok  # even a call of the same service
    assert not slow.done()
    robot.chassis.drop()
    assert not wait_future(slow).ok


def test_large_values_are_sent_aside_even_the_last_known_one(robot: Robot, monkeypatch) -> None:
    path = NavPathProto()
    for number in range(3000):
        path.path.poses.add(x=number / 100.0)
    remove = robot.chassis.intercept(
        lambda out: [replace(out, body=path) if out.request == NAV_PATH else out]
    )
    threads: set[str] = set()
    send = Reply.send

    def noted(reply: Reply, response: Any) -> None:
        threads.add(threading.current_thread().name)
        send(reply, response)

    monkeypatch.setattr(Reply, "send", noted)
    assert len(robot.call(NavPath, "robot/NavPath").nav_path.path.poses) == 3000
    remove()
    robot.chassis.refuse(NAV_PATH, "no")
    calls = [robot.call_async(NavPath, "robot/NavPath") for _ in range(5)]
    assert [len(wait_future(call).nav_path.path.poses) for call in calls] == 5 * [3000]
    assert threads == {"large messages_0"}


def test_text_that_ros_cannot_encode_does_not_lose_the_answer(robot: Robot) -> None:
    """A JSON string may contain a lone surrogate, which has no UTF-8 encoding."""
    answer_with_json(robot.chassis, SPEAK, msg="a\ud800b")
    response = wait_future(speak(robot, "x"))
    assert response.ok
    assert (response.msg[0], response.msg[-1]) == ("a", "b")
    assert robot.call(General, "robot/General").info.serial_number == 30001


def test_an_exception_in_a_callback_is_answered(robot: Robot, logs: Logs, monkeypatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(robot.agent.agent.robot.requests, "make", lambda *_: 1 / 0)
        response = robot.call(SetSound, "setting/Sound")
    assert not response.ok
    assert "ZeroDivisionError" in response.msg
    assert robot.call(Mode, "robot/Mode").info.ctrl.value == 1
    assert [record.levelname for record in logs.messages if record.exc_info] == ["ERROR"]


def test_a_reply_is_sent_once(logs):
    sent: list[Any] = []
    reply = Reply(Speak.Response, lambda *answer: sent.append(answer), "header")
    reply.send(Speak.Response(msg="a"))
    reply.fail(RuntimeError("b"))
    assert sent == [(Speak.Response(msg="a"), "header")]
    assert [record.levelname for record in logs.messages] == ["ERROR"]


def test_an_error_while_sending_is_answered():
    error = OverflowError("large")
    sent: list[Any] = []

    def send(response: Any, header: Any) -> None:
        if response.ok:
            raise error
        sent.append((response.msg, header))

    Reply(Speak.Response, send, "header").send(Speak.Response(ok=True))
    assert [(type(error).__name__ in text, header) for text, header in sent] == [(True, "header")]


DOWNLOAD, UPLOAD = "woosh.map.Download", "woosh.map.Upload"


@pytest.mark.timeout(300)
def test_a_large_map_is_downloaded_and_uploaded_unchanged(robot: Robot) -> None:
    """And holds up no other request; tests/link has the other transports and encodings."""
    data = random.Random(1).randbytes(12 * 1024 * 1024)
    scene = DownloadResponse()
    scene.file_datas.add(name="map.png", data=data)
    scene.file_datas.add(name="marks.json", data=b"{}")
    replace_answers(
        robot.chassis, DOWNLOAD, ok=True, msg="", type=f"{DOWNLOAD}Response", body=scene
    )
    download = robot.call_async(Download, "map/Download", arg=DownloadMsg(scene_name="hall"))
    assert robot.call(Mode, "robot/Mode").info.ctrl.value == 1
    response = wait_future(download)
    assert response.ok, response.msg
    assert [file.name for file in response.ret.file_datas] == ["map.png", "marks.json"]
    assert response.ret.file_datas[0].data.tobytes() == data
    assert response.ret.file_datas[1].data.tobytes() == b"{}"

    replace_answers(robot.chassis, UPLOAD, ok=True, msg="", type=UPLOAD, body=None)
    files = [FileData(name="map.png", data=array("B", data))]
    upload = robot.call_async(
        Upload, "map/Upload", arg=UploadMsg(scene_name="hall", file_datas=files)
    )
    assert robot.call(Mode, "robot/Mode").info.ctrl.value == 1
    response = wait_future(upload)
    assert response.ok, response.msg
    assert robot.chassis.last(UPLOAD).file_datas[0].data == data
