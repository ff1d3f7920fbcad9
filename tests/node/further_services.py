"""What each service that the manufacturer's agent lacks does on the simulated robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.harness import Client, wait_until
from woosh_map_msgs.srv import SceneList
from woosh_robot_msgs.msg import BuildMapBuildType, DeploymentMode, DeploymentType, WorkMode
from woosh_robot_msgs.srv import ExecTaskSet, RobotState
from woosh_task_msgs.msg import RepeatTaskOrder
from woosh_task_msgs.srv import RepeatTasks

PNG = b"\x89PNG"
MAPPING = 9


def accepted(client: Client, name: str, /, **values: Any) -> Any:
    """Call a service that must succeed, with these values in its argument; return its response."""
    response = client.command(name, **values)
    assert response.ok, f"{name}: {response.msg}"
    return response


def scenes(client: Client) -> dict[str, list[str]]:
    """Return the names of the maps of each scene."""
    listed = client.call(SceneList, "map/SceneList").info.scenes
    return {scene.name: list(scene.maps) for scene in listed}


def files(client: Client, scene: str) -> Any:
    return accepted(client, "map/Download", scene_name=scene).ret.file_datas


def scene_list(client: Client) -> None:
    assert {"wooshmap", "scenex"} <= scenes(client).keys()


def scene_data(client: Client) -> None:
    ret = accepted(client, "map/SceneData", name="scenex").ret
    assert ret.name == "scenex"
    assert all(bytes(each.map_png).startswith(PNG) for each in ret.maps)
    refused = client.command("map/SceneData", name="nowhere")
    assert (refused.ok, "nowhere" in refused.msg) == (False, True)


def download(client: Client) -> None:
    found = files(client, "scenex")
    assert found
    assert all(each.name and len(each.data) for each in found)


def upload(client: Client) -> None:
    accepted(client, "map/Upload", scene_name="copy", file_datas=files(client, "scenex"))
    assert scenes(client)["copy"] == scenes(client)["scenex"]


def rename(client: Client) -> None:
    maps = scenes(client)["scenex"]
    accepted(client, "map/Rename", old_scene_name="scenex", new_scene_name="hall")
    assert (scenes(client)["hall"], "scenex" in scenes(client)) == (maps, False)


def delete(client: Client) -> None:
    accepted(client, "map/Delete", scene_name="scenex")
    assert "scenex" not in scenes(client)


def md5_sums(client: Client) -> Any:
    return accepted(client, "map/SceneMd5", scene_name="scenex").ret.scenes


def scene_md5(client: Client) -> None:
    (scene,) = md5_sums(client)
    assert (scene.scene_name, bool(scene.maps)) == ("scenex", True)


def scene_sync(client: Client) -> None:
    accepted(client, "map/SceneSync", scenes=md5_sums(client))


def find(client: Client, number: str) -> Any:
    return client.command("map/storage/Find", no=number)


def storage_find(client: Client) -> None:
    found = find(client, "A2")
    assert (found.ok, found.ret.identity.no) == (True, "A2")
    missing = find(client, "B99")
    assert (missing.ok, "B99" in missing.msg) == (False, True)


def storage_create(client: Client) -> None:
    storage = find(client, "A2").ret
    storage.identity.no, storage.identity.id = "B7", 0
    created = accepted(client, "map/storage/Create", storage=storage).ret
    assert created.identity.no == "B7"
    assert find(client, "B7").ret.pose == created.pose


def storage_update(client: Client) -> None:
    storage = find(client, "A2").ret
    storage.pose.real.x += 0.25
    accepted(client, "map/storage/Update", storage=storage)
    assert find(client, "A2").ret.pose.real.x == storage.pose.real.x


def storage_delete(client: Client) -> None:
    accepted(client, "map/storage/Delete", no="A2")
    assert not find(client, "A2").ok


def storages(client: Client) -> None:
    assert accepted(client, "map/storage/Storages").ret is not None


def plan_nav_path(client: Client) -> None:
    start, end = {"x": 4.23, "y": -6.67}, {"x": 2.0, "y": -6.0}
    poses = accepted(client, "robot/PlanNavPath", start=start, end=end).ret.path.poses
    assert (round(poses[-1].x, 1), round(poses[-1].y, 1)) == (2.0, -6.0)


def count_data(client: Client) -> None:
    ret = accepted(client, "robot/CountData").ret
    assert ret.operation_qty == len(ret.operations.ops) > 0


def deployment_mode(client: Client) -> None:
    accepted(client, "robot/SwitchWorkMode", mode=WorkMode.K_DEPLOY_MODE)


def build_map(client: Client) -> None:
    deployment_mode(client)
    names = {"scene_name": "new", "map_name": "new"}
    accepted(client, "robot/BuildMap", type=BuildMapBuildType.K_ADD, **names)
    wait_until(lambda: state(client) == MAPPING, "the robot to make a map")
    accepted(client, "robot/BuildMap", type=BuildMapBuildType.K_CANEL, **names)
    wait_until(lambda: state(client) != MAPPING, "the end of the mapping")


def state(client: Client) -> int:
    return int(client.call(RobotState, "robot/RobotState").info.state.value)


def deployment(client: Client) -> None:
    deployment_mode(client)
    (marker,) = accepted(
        client,
        "robot/Deployment",
        type=DeploymentType.K_MARK,
        mode=DeploymentMode.K_DEP_COLLECT,
        has_field=0,  # without a pose: where the robot stands
    ).ret.markers
    assert round(marker.pose.x, 2) == 4.23


def led(client: Client) -> None:
    accepted(client, "robot/LED", color=3)


def repeat_task(client: Client) -> None:
    task_set = client.call(RepeatTasks, "task/RepeatTasks").info.repeat_tasks[0].task_set
    task_set.base.id = 4711
    accepted(client, "task/RepeatTask", order=RepeatTaskOrder.K_PUT, task_set=task_set)
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
