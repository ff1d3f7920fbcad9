"""What each service that the manufacturer's agent lacks does on the simulated robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.harness import Client, wait_until
from woosh_map_msgs.srv import (
    Delete,
    Download,
    Rename,
    SceneData,
    SceneList,
    SceneMd5,
    SceneSync,
    StorageCreate,
    StorageDelete,
    StorageFind,
    StorageStorages,
    StorageUpdate,
    Upload,
)
from woosh_robot_msgs.srv import (
    LED,
    BuildMap,
    CountData,
    Deployment,
    ExecTaskSet,
    PlanNavPath,
    RobotState,
    SwitchWorkMode,
)
from woosh_task_msgs.srv import RepeatTask, RepeatTasks

PNG = b"\x89PNG"
MAPPING = 9


def accepted(client: Client, srv: Any, name: str, arg: Any) -> Any:
    """Call a service that must succeed; return its response."""
    response = client.call(srv, name, arg=arg)
    assert response.ok, f"{name}: {response.msg}"
    return response


def scenes(client: Client) -> dict[str, list[str]]:
    """Return the names of the maps of each scene."""
    listed = client.call(SceneList, "map/SceneList").info.scenes
    return {scene.name: list(scene.maps) for scene in listed}


def files(client: Client, scene: str) -> Any:
    arg = Download.Request().arg
    arg.scene_name = scene
    return accepted(client, Download, "map/Download", arg).ret.file_datas


def scene_list(client: Client) -> None:
    assert {"wooshmap", "scenex"} <= scenes(client).keys()


def scene_data(client: Client) -> None:
    arg = SceneData.Request().arg
    arg.name = "scenex"
    ret = accepted(client, SceneData, "map/SceneData", arg).ret
    assert ret.name == "scenex"
    assert all(bytes(each.map_png).startswith(PNG) for each in ret.maps)
    arg.name = "nowhere"
    refused = client.call(SceneData, "map/SceneData", arg=arg)
    assert (refused.ok, "nowhere" in refused.msg) == (False, True)


def download(client: Client) -> None:
    found = files(client, "scenex")
    assert found
    assert all(each.name and len(each.data) for each in found)


def upload(client: Client) -> None:
    arg = Upload.Request().arg
    arg.scene_name = "copy"
    arg.file_datas = files(client, "scenex")
    accepted(client, Upload, "map/Upload", arg)
    assert scenes(client)["copy"] == scenes(client)["scenex"]


def rename(client: Client) -> None:
    maps = scenes(client)["scenex"]
    arg = Rename.Request().arg
    arg.old_scene_name, arg.new_scene_name = "scenex", "hall"
    accepted(client, Rename, "map/Rename", arg)
    assert (scenes(client)["hall"], "scenex" in scenes(client)) == (maps, False)


def delete(client: Client) -> None:
    arg = Delete.Request().arg
    arg.scene_name = "scenex"
    accepted(client, Delete, "map/Delete", arg)
    assert "scenex" not in scenes(client)


def md5_sums(client: Client) -> Any:
    arg = SceneMd5.Request().arg
    arg.scene_name = "scenex"
    return accepted(client, SceneMd5, "map/SceneMd5", arg).ret.scenes


def scene_md5(client: Client) -> None:
    (scene,) = md5_sums(client)
    assert (scene.scene_name, bool(scene.maps)) == ("scenex", True)


def scene_sync(client: Client) -> None:
    arg = SceneSync.Request().arg
    arg.scenes = md5_sums(client)
    assert accepted(client, SceneSync, "map/SceneSync", arg)


def find(client: Client, number: str) -> Any:
    arg = StorageFind.Request().arg
    arg.no = number
    return client.call(StorageFind, "map/storage/Find", arg=arg)


def storage_find(client: Client) -> None:
    found = find(client, "A2")
    assert (found.ok, found.ret.identity.no) == (True, "A2")
    missing = find(client, "B99")
    assert (missing.ok, "B99" in missing.msg) == (False, True)


def storage_create(client: Client) -> None:
    arg = StorageCreate.Request().arg
    arg.storage = find(client, "A2").ret
    arg.storage.identity.no, arg.storage.identity.id = "B7", 0
    created = accepted(client, StorageCreate, "map/storage/Create", arg).ret
    assert created.identity.no == "B7"
    assert find(client, "B7").ret.pose == created.pose


def storage_update(client: Client) -> None:
    arg = StorageUpdate.Request().arg
    arg.storage = find(client, "A2").ret
    arg.storage.pose.real.x += 0.25
    accepted(client, StorageUpdate, "map/storage/Update", arg)
    assert find(client, "A2").ret.pose.real.x == arg.storage.pose.real.x


def storage_delete(client: Client) -> None:
    arg = StorageDelete.Request().arg
    arg.no = "A2"
    accepted(client, StorageDelete, "map/storage/Delete", arg)
    assert not find(client, "A2").ok


def storages(client: Client) -> None:
    arg = StorageStorages.Request().arg
    assert accepted(client, StorageStorages, "map/storage/Storages", arg).ret is not None


def plan_nav_path(client: Client) -> None:
    arg = PlanNavPath.Request().arg
    arg.start.x, arg.start.y = 4.23, -6.67
    arg.end.x, arg.end.y = 2.0, -6.0
    poses = accepted(client, PlanNavPath, "robot/PlanNavPath", arg).ret.path.poses
    assert (round(poses[-1].x, 1), round(poses[-1].y, 1)) == (2.0, -6.0)


def count_data(client: Client) -> None:
    ret = accepted(client, CountData, "robot/CountData", CountData.Request().arg).ret
    assert ret.operation_qty == len(ret.operations.ops) > 0


def deployment_mode(client: Client) -> None:
    arg = SwitchWorkMode.Request().arg
    arg.mode.value = arg.mode.K_DEPLOY_MODE
    accepted(client, SwitchWorkMode, "robot/SwitchWorkMode", arg)


def build_map(client: Client) -> None:
    deployment_mode(client)
    arg = BuildMap.Request().arg
    arg.type.value = arg.type.K_ADD
    arg.scene_name = arg.map_name = "new"
    accepted(client, BuildMap, "robot/BuildMap", arg)
    wait_until(lambda: state(client) == MAPPING, "the robot to make a map")
    arg.type.value = arg.type.K_CANEL
    accepted(client, BuildMap, "robot/BuildMap", arg)
    wait_until(lambda: state(client) != MAPPING, "the end of the mapping")


def state(client: Client) -> int:
    return int(client.call(RobotState, "robot/RobotState").info.state.value)


def deployment(client: Client) -> None:
    deployment_mode(client)
    arg = Deployment.Request().arg
    arg.type.value, arg.mode.value = arg.type.K_MARK, arg.mode.K_DEP_COLLECT
    arg.has_field = 0  # where the robot stands
    (marker,) = accepted(client, Deployment, "robot/Deployment", arg).ret.markers
    assert round(marker.pose.x, 2) == 4.23


def led(client: Client) -> None:
    arg = LED.Request().arg
    arg.color = 3
    accepted(client, LED, "robot/LED", arg)


def repeat_task(client: Client) -> None:
    arg = RepeatTask.Request().arg
    arg.order.value = arg.order.K_PUT
    arg.task_set = client.call(RepeatTasks, "task/RepeatTasks").info.repeat_tasks[0].task_set
    arg.task_set.base.id = 4711
    accepted(client, RepeatTask, "task/RepeatTask", arg)
    sets = client.call(RepeatTasks, "task/RepeatTasks").info.repeat_tasks
    assert 4711 in [each.task_set.base.id for each in sets]


def exec_task_set(client: Client) -> None:
    response = client.call(ExecTaskSet, "robot/ExecTaskSet")
    assert (response.ok, bool(response.msg)) == (False, True), "robots do not implement it"


FURTHER: dict[str, Callable[[Client], None]] = {
    "map/Delete": delete,
    "map/Download": download,
    "map/Rename": rename,
    "map/SceneData": scene_data,
    "map/SceneList": scene_list,
    "map/SceneMd5": scene_md5,
    "map/SceneSync": scene_sync,
    "map/Upload": upload,
    "map/storage/Create": storage_create,
    "map/storage/Delete": storage_delete,
    "map/storage/Find": storage_find,
    "map/storage/Storages": storages,
    "map/storage/Update": storage_update,
    "robot/BuildMap": build_map,
    "robot/CountData": count_data,
    "robot/Deployment": deployment,
    "robot/ExecTaskSet": exec_task_set,
    "robot/LED": led,
    "robot/PlanNavPath": plan_nav_path,
    "task/RepeatTask": repeat_task,
}
"""Test of each service, by its name."""
