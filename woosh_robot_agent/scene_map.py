"""The current map of a scene, requested from the chassis."""

from __future__ import annotations

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.map_image import MapError
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData


async def scene_map(
    chassis: ChassisClient, scene_name: str, map_id: int, map_name: str
) -> SceneData.Map:
    """Request a scene, and return one of its maps; it can have many MiB.

    Args:
        chassis: the link.
        scene_name: name of the scene.
        map_id: id of the map, used if no map has the name.
        map_name: name of the map.

    Raises:
        LinkError: as in `ChassisClient.request`.
        MapError: the chassis refuses, or the map is missing, or it has no image.
    """
    answer = await chassis.request(SceneData(name=scene_name))
    if not answer.ok:
        raise MapError(f"the chassis refused SceneData of {scene_name}: {answer.msg}")
    if not isinstance(answer.body, SceneData):
        raise MapError(f"the chassis sent no SceneData: {answer.defect or answer.type}")
    return _find(answer.body, map_id, map_name)


def _find(data: SceneData, map_id: int, map_name: str) -> SceneData.Map:
    """Return a map of a scene.

    Raises:
        MapError: it is missing, or has no image.
    """
    found = [each for each in data.maps if each.name == map_name] or [
        each for each in data.maps if each.id == map_id
    ]
    if not found:
        raise MapError(f"SceneData of {data.name} has no map {map_name} ({map_id})")
    if not found[0].map_png:
        raise MapError(f"map {found[0].name} has no image")
    return found[0]
