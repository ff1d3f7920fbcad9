"""Requests to the robot. Each refusal and each lost link is a `MapsError`."""

from __future__ import annotations

from typing import TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link import ChassisClient, LinkError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map import map_pack_pb2 as pack
from woosh_robot_agent.pb.map import mark_pb2, storage_edit_pb2
from woosh_robot_agent.pb.robot.robot_pb2 import Scene
from woosh_robot_agent.pb.util.common_pb2 import FileData
from woosh_robot_agent.tools.maps.scene_folder import MapsError

SLOW_ANSWERS = {
    "woosh.map.Download": 300.0,
    "woosh.map.Upload": 300.0,
    "woosh.map.SceneData": 300.0,
    "woosh.map.SceneDataEasy": 60.0,
    "woosh.map.SceneList": 60.0,
    "woosh.map.Rename": 60.0,
    "woosh.map.Delete": 60.0,
}
"""Minimum timeouts of requests, in seconds. Robots have taken minutes to save a map."""

_M = TypeVar("_M", bound=Message)
"""Class of the message in an answer."""


class Robot:
    """The map library of one robot.

    Args:
        chassis: The link, which must be ready.

    Attributes:
        chassis: The link.
    """

    def __init__(self, chassis: ChassisClient) -> None:
        self.chassis = chassis

    async def scenes(self) -> dict[str, list[str]]:
        """Return the names of all scenes, each with those of its maps."""
        answer = await self._query(pack.SceneList(), pack.SceneList)
        return {scene.name: list(scene.maps) for scene in answer.scenes}

    async def current(self) -> Scene:
        """Return the current scene and map."""
        return await self._query(Scene(), Scene)

    async def overview(self, scene: str) -> pack.SceneDataEasy:
        """Return the maps of a scene with their marks, without pictures."""
        return await self._query(pack.SceneDataEasy(name=scene), pack.SceneDataEasy)

    async def scene_data(self, scene: str) -> pack.SceneData:
        """Return the maps of a scene with their pictures and marks."""
        return await self._query(pack.SceneData(name=scene), pack.SceneData)

    async def download(self, scene: str) -> dict[str, bytes]:
        """Return the files of a scene, by the names that the robot gives them."""
        request = pack.Download(scene_name=scene)
        answer = await self._query(request, pack.DownloadResponse)
        files = {file.name: file.data for file in answer.file_datas}
        if len(files) < len(answer.file_datas):
            raise MapsError(f"the robot sent two files of the same name for scene {scene}")
        if not files:
            raise MapsError(f"the robot sent no files for scene {scene}")
        return files

    async def upload(self, scene: str, files: dict[str, bytes]) -> None:
        """Store a scene, in place of the one of its name. The robot takes all files or none."""
        datas = [FileData(name=name, data=data) for name, data in files.items()]
        await self._request(
            pack.Upload(scene_name=scene, file_datas=datas, method=pack.Upload.kFull)
        )

    async def rename(self, request: pack.Rename) -> None:
        """Rename a scene or a map."""
        await self._request(request)

    async def delete(self, scene: str, area: str) -> None:
        """Delete a map, or the whole scene if `area` is empty."""
        await self._request(pack.Delete(scene_name=scene, map_name=area))

    async def create_mark(self, storage: mark_pb2.Storage) -> None:
        """Add a mark to the current map."""
        await self._request(storage_edit_pb2.Create(storage=storage))

    async def update_mark(self, storage: mark_pb2.Storage) -> None:
        """Change a mark of the current map."""
        await self._request(storage_edit_pb2.Update(storage=storage))

    async def delete_mark(self, number: str) -> None:
        """Delete a mark of the current map."""
        await self._request(storage_edit_pb2.Delete(no=number))

    async def _query(self, request: Message, cls: type[_M]) -> _M:
        body, defect = await self._request(request)
        if not isinstance(body, cls):
            raise MapsError(
                f"the robot answered {full_name(request)} with {defect}, not with "
                f"{full_name(cls)}: its firmware may not have this request"
            )
        return body

    async def _request(self, request: Message) -> tuple[Message | None, str]:
        """Send a request; return the body of the answer, and the reason if it is unusable."""
        try:
            answer = await self.chassis.request(request)
        except LinkError as error:
            raise MapsError(f"{full_name(request)}: {error}") from None
        if not answer.ok:
            reason = answer.msg or "no reason given"
            raise MapsError(f"the robot refused {full_name(request)}: {reason}")
        return answer.body, answer.defect or answer.type
