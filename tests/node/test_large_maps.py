"""Maps of many MiB pass unchanged, and hold up no other request.

tests/link/test_link_large_frames.py has the other transports and encodings.
"""

from __future__ import annotations

import random
from array import array

import pytest

from tests.harness import Client, wait_future
from tests.node.goals import replace_answers
from woosh_common_msgs.msg import FileData
from woosh_map_msgs.msg import Download as DownloadMsg
from woosh_map_msgs.msg import Upload as UploadMsg
from woosh_map_msgs.srv import Download, Upload
from woosh_robot_agent.pb.map.map_pack_pb2 import DownloadResponse
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import Mode

DOWNLOAD, UPLOAD = "woosh.map.Download", "woosh.map.Upload"
SIZE = 12 * 1024 * 1024
TIMEOUT = 120.0

pytestmark = pytest.mark.timeout(300)


@pytest.mark.usefixtures("agent")
def test_a_large_map_is_downloaded_and_uploaded_unchanged(
    simulator: SimulatorThread, client: Client
) -> None:
    data = random.Random(1).randbytes(SIZE)
    scene = DownloadResponse()
    scene.file_datas.add(name="map.png", data=data)
    scene.file_datas.add(name="marks.json", data=b"{}")
    replace_answers(simulator, DOWNLOAD, ok=True, msg="", type=f"{DOWNLOAD}Response", body=scene)
    download = client.call_async(Download, "map/Download", arg=DownloadMsg(scene_name="hall"))
    assert client.call(Mode, "robot/Mode", timeout=TIMEOUT).info.ctrl.value == 1
    response = wait_future(download, TIMEOUT)
    assert response.ok, response.msg
    assert [file.name for file in response.ret.file_datas] == ["map.png", "marks.json"]
    assert response.ret.file_datas[0].data.tobytes() == data
    assert response.ret.file_datas[1].data.tobytes() == b"{}"

    replace_answers(simulator, UPLOAD, ok=True, msg="", type=UPLOAD, body=None)
    files = [FileData(name="map.png", data=array("B", data))]
    upload = client.call_async(
        Upload, "map/Upload", arg=UploadMsg(scene_name="hall", file_datas=files)
    )
    assert client.call(Mode, "robot/Mode", timeout=TIMEOUT).info.ctrl.value == 1
    response = wait_future(upload, TIMEOUT)
    assert response.ok, response.msg
    received = simulator.last(UPLOAD)
    assert received is not None
    assert received.file_datas[0].data == data  # type: ignore[attr-defined]
