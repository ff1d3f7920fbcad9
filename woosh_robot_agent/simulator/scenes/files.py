"""Reads scenes from files: a folder with `scene.yaml` and pictures, or maps of nav2's map_server.

`scene.yaml` looks like this. Only `maps` and their names are required:

    name: lab                       # default: the folder's name
    start: {map: ground, pose: [1.0, 2.0, 0.0]}  # initial pose of the robot
    maps:
      - name: ground
        id: 7                       # default: the first one from 1 that no map has
        floor: 1F
        version: 3                  # default: 1
        image: ground.yaml          # a map of map_server, with its PNG or PGM beside it
        area: [-5, -5, 20, 15]      # two corners of the mapped area; default: around everything
        walls:                      # polylines: x and y of each corner
          - [0, 0, 0, 5, 5, 5]
        marks:
          - {number: A1, type: rack, pose: [4.0, 1.0, 1.57], description: by the door}
      - name: yard
        image: yard.yaml
        mark_info: yard.mark_info.data  # instead of marks: a serialised woosh.map.mark.MarkInfo
    tasks:
      predefined:                   # task sets for ExecPreTask
        - {id: 12, name: round, times: 2, steps: [{mark: A1, type: pick}]}
      calls:                        # task sets for call buttons
        - {id: 13, name: fetch, button: {mac: "00:12:4b:00:00:01", key: 1}, steps: [{mark: A1}]}
    task_info: task_info.data         # instead of tasks: a serialised woosh.task.TaskInfo

Lengths are in metres, angles in radians, poses are [x, y, theta]. A map needs an image or walls and
can have both. The type of a mark is one of `MarkKind` in lower case (default: base). Its `id` is by
default its index in the list, from 1. The type of a step is pick (default), parking, charge or
carry; its direction is feeding or cutting. With `wait` the robot then waits for this time in
seconds, or with -1 until a client tells it to continue.

Without `scene.yaml`, each map of map_server in the folder becomes a map of the scene, named after
its YAML file. Its marks come from a file NAME.mark_info.data, if there is one.

The shipped scenes are in the folder `data/`. `wooshmap` is a hall with two partitions, three
pillars and a gate. `scenex` is the same hall furnished differently, with a second, empty floor.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import count, pairwise
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, TypeVar

from google.protobuf.message import DecodeError, Message

from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.task import task_pb2, woosh_task_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.scenes.scene import Scene, has_pose, marks_of, other_marks
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall
from woosh_robot_agent.simulator.world.maps import ImageFiles, Map, Mark, MarkKind
from woosh_robot_agent.simulator.yaml_fields import DataFileError, Node, parse

MAX_NAME = 255
"""Maximum length of a name, in characters."""


def is_plain(name: str) -> bool:
    """Return True if a name is not empty and is a file name, not a path, on every system."""
    plain = PurePosixPath(name).name == PureWindowsPath(name).name == name
    return plain and name not in ("", "..") and name.isprintable() and len(name) <= MAX_NAME


Read = Callable[[str], bytes]
"""Returns the content of the file with the given name, or raises `DataFileError`."""

TASK_INFO = "task_info.data"
"""Name of the file with the tasks of a scene, a `woosh.task.TaskInfo`."""

MARK_INFO = ".mark_info.data"
"""End of the name of a file with the marks of a map, a `woosh.map.mark.MarkInfo`."""

MAX_MARKS = 5000
"""Maximum number of marks of a map."""

MAX_TASKS = 200
"""Maximum number of task sets of one kind, and of tasks in a set."""

_M = TypeVar("_M", bound=Message)
"""Class of the message in a file."""


def read_task_info(name: str, read: Read) -> woosh_task_pb2.TaskInfo:
    """Read a file with the tasks of a scene.

    Raises:
        DataFileError: The file cannot be used.
    """
    info = _message(name, read, woosh_task_pb2.TaskInfo)
    counts = [len(info.repeat_tasks), len(info.call_tasks)]
    counts += [len(each.task_set.tasks) for each in info.repeat_tasks]
    counts += [len(each.task_set.tasks) for each in info.call_tasks]
    if max(counts) > MAX_TASKS:
        raise DataFileError(f"{name}: {max(counts)} tasks are more than {MAX_TASKS}")
    return info


def read_mark_info(name: str, read: Read) -> mark_pb2.MarkInfo:
    """Read a file with the marks of a map.

    Raises:
        DataFileError: The file cannot be used.
    """
    info = _message(name, read, mark_pb2.MarkInfo)
    if len(info.storages) > MAX_MARKS:
        raise DataFileError(f"{name}: {len(info.storages)} marks are more than {MAX_MARKS}")
    numbers: set[str] = set()
    ids: set[int] = set()
    for index, storage in enumerate(info.storages):
        where, identity = f"{name}: storages[{index}]", storage.identity
        if not identity.no:
            raise DataFileError(f"{where}: identity.no is missing")
        if identity.no in numbers or identity.id in ids:
            raise DataFileError(
                f"{where}: its number {identity.no} or id {identity.id} is used twice"
            )
        if not has_pose(storage):
            raise DataFileError(f"{where}: pose.dock is missing")
        for pose in (storage.pose.dock, storage.pose.real):
            if not all(map(math.isfinite, (pose.x, pose.y, pose.theta))):
                raise DataFileError(f"{where}: the pose is not finite")
        numbers.add(identity.no)
        ids.add(identity.id)
    return info


def _message(name: str, read: Read, cls: type[_M]) -> _M:
    try:
        return cls.FromString(read(name))
    except DecodeError as error:
        text = f"{name}: not a serialised {cls.DESCRIPTOR.full_name}: {error}"
        raise DataFileError(text) from error


if TYPE_CHECKING:
    from woosh_robot_agent.simulator.world.grid import Grid

SCENE_FILE = "scene.yaml"

MAX_MAPS = 50
"""Maximum number of maps of a scene."""

_MAX_WALLS = 1000
"""Laser and planner check each wall. A map with more walls needs a picture instead."""

_MAX_FILE_BYTES = 64 * 1024 * 1024
_MAX_PIXELS = 32 * 1024 * 1024
"""Limit for all pictures of a scene together. Reading them blocks the simulator."""

_MAX_SIDE = 500.0
"""Maximum length of a side of a map, in metres."""

_DEFAULT_FLOOR = "1F"

_UINT32 = 2**32 - 1
_INT32 = 2**31 - 1
_KINDS = {kind.name.lower(): kind for kind in MarkKind}
_DIRECTIONS = {"feeding": util_task_pb2.kFeeding, "cutting": util_task_pb2.kCutting}
_TASK_TYPES = {name[1:].lower(): name for name, value in util_task_pb2.Type.items() if value}


def load_scene(path: Path) -> Scene:
    """Read the scene in a folder or of one YAML file: a `scene.yaml` or a map of map_server.

    Raises:
        DataFileError: A file cannot be used.
    """

    def read(name: str) -> bytes:
        file = folder / name
        try:
            if file.stat().st_size > _MAX_FILE_BYTES:
                raise DataFileError(f"{file}: the file has more than {_MAX_FILE_BYTES} bytes")
            return file.read_bytes()
        except OSError as error:
            raise DataFileError(f"{file}: {error.strerror or error}") from error

    if path.is_dir():
        folder, name = path, path.resolve().name
        names = sorted(file.name for file in path.iterdir())
    else:
        folder, names = path.parent, [path.name]
        name = path.resolve().parent.name if path.name == SCENE_FILE else path.stem
    scene = read_scene(name, names, read, use_own_name=True)
    if scene is None:
        raise DataFileError(
            f"{path}: not a scene: give a {SCENE_FILE}, a YAML file of nav2's map_server, or a "
            "folder with one of them"
        )
    return scene


def read_scene(
    name: str, names: Collection[str], read: Read, *, use_own_name: bool = False
) -> Scene | None:
    """Read a scene from some files. Return None if none of them describes a scene or a map.

    Args:
        name: Name of the scene.
        names: Names of the files.
        read: Returns the content of a file.
        use_own_name: Prefer the name in `scene.yaml`, if it has one.

    Raises:
        DataFileError: A file cannot be used.
    """
    if SCENE_FILE in names:
        keys = ("name", "start", "maps", "tasks", "task_info")
        root = parse(SCENE_FILE, read(SCENE_FILE)).check_keys(keys)
        named = root.get("name")
        return _scene(root, named.text() if named and use_own_name else name, read)
    maps = read_maps(names, read)
    return Scene(name, maps) if maps else None


def read_maps(names: Collection[str], read: Read) -> list[Map]:
    """Read the maps of map_server among some files.

    Raises:
        DataFileError: A file cannot be used.
    """
    maps: list[Map] = []
    for each in sorted(names):
        if Path(each).suffix in (".yaml", ".yml"):
            description = parse(each, read(each))
            if isinstance(description.value, dict) and description.get("image"):
                stem = Path(each).stem
                grid, image = _grid(each, description, read)
                low, high = _bounds(description, [grid.low, grid.high])
                area = Map(
                    len(maps) + 1,
                    stem,
                    _DEFAULT_FLOOR,
                    1,
                    low,
                    high,
                    walls=(),
                    grid=grid,
                    image=image,
                )
                if stem + MARK_INFO in names:
                    info = read_mark_info(stem + MARK_INFO, read)
                    area = replace(
                        area,
                        floor=info.floor_name or area.floor,
                        marks=marks_of(info),
                        other_marks=other_marks(info),
                    )
                maps.append(area)
                _check_pictures(description, maps)
                if stem in [other.name for other in maps[:-1]]:
                    raise description.error(f"another file has the map name {stem} too")
    return maps


def _scene(root: Node, name: str, read: Read) -> Scene:
    nodes = list(root.required("maps").items(MAX_MAPS))
    if not nodes:
        raise root.required("maps").error("a scene needs at least one map")
    maps: list[Map] = []
    # Not from 0, with which robots report a pose that belongs to no map.
    given = [id_.value for node in nodes if (id_ := node.get("id"))]
    free_ids = (number for number in count(1) if number not in given)
    for node in nodes:
        maps.append(_map(node, free_ids, read))
        _check_pictures(node, maps)
    _all_different(nodes, "name", [each.name for each in maps])
    _all_different(nodes, "id", [each.id for each in maps])
    scene = Scene(name, maps)
    start = root.get("start")
    if start:
        start.check_keys(("map", "pose"))
        on = start.get("map")
        scene.start_map = on.choice([each.name for each in maps]) if on else ""
        scene.start = _pose(start.required("pose"))
    tasks, task_info = root.get("tasks"), root.get("task_info")
    if task_info:
        if tasks:
            raise task_info.error("give tasks or task_info, not both")
        info = read_task_info(task_info.text(), read)
        scene.predefined.repeat_tasks.extend(info.repeat_tasks)
        scene.calls.call_tasks.extend(info.call_tasks)
    if tasks:
        tasks.check_keys(("predefined", "calls"))
        marks = {number for each in maps for number in each.marks}
        scene.predefined.repeat_tasks.extend(_predefined(tasks, marks))
        scene.calls.call_tasks.extend(_calls(tasks, marks))
    return scene


def _map(node: Node, free_ids: Iterator[int], read: Read) -> Map:
    node.check_keys(
        ("name", "id", "floor", "version", "image", "area", "walls", "marks", "mark_info")
    )
    id_, floor, version = node.get("id"), node.get("floor"), node.get("version")
    walls = tuple(wall for each in _items(node, "walls", _MAX_WALLS) for wall in _walls(each))
    if len(walls) > _MAX_WALLS:
        raise node.required("walls").error(f"{len(walls)} walls are more than {_MAX_WALLS}")
    mark_info = node.get("mark_info")
    if mark_info and node.get("marks"):
        raise mark_info.error("give marks or mark_info, not both")
    info = read_mark_info(mark_info.text(), read) if mark_info else mark_pb2.MarkInfo()
    marks = marks_of(info) if mark_info else _marks(node)
    image, area = node.get("image"), node.get("area")
    grid, files = None, None
    if image:
        grid, files = _grid(image.text(), parse(image.text(), read(image.text())), read)
    elif not walls:
        raise node.error("a map needs an image or walls")
    if area:
        x1, y1, x2, y2 = area.numbers("x1, y1, x2, y2")
        corners = [(x1, y1), (x2, y2)]
    else:
        corners = [point for wall in walls for point in ((wall.x1, wall.y1), (wall.x2, wall.y2))]
        corners += [mark.pose.point for mark in marks.values()]
        corners += [grid.low, grid.high] if grid else []
    low, high = _bounds(area or node, corners)
    return Map(
        id=id_.integer(0, _UINT32) if id_ else next(free_ids),
        name=node.required("name").text(),
        floor=floor.text() if floor else info.floor_name or _DEFAULT_FLOOR,
        version=version.integer(1, _INT32) if version else min(max(1, info.version), _INT32),
        low=low,
        high=high,
        walls=walls,
        marks=marks,
        grid=grid,
        image=files,
        other_marks=other_marks(info),
    )


def _grid(name: str, description: Node, read: Read) -> tuple[Grid, ImageFiles | None]:
    """Return a grid and its files, or None for these if their names are paths."""
    # numpy, scipy and Pillow load in a third of a second, which only pictures need.
    from woosh_robot_agent.simulator.scenes.map_server import read_grid

    folder = Path(name).parent
    pictures: list[bytes] = []

    def read_picture(picture_name: str) -> bytes:
        pictures.append(read(str(folder / picture_name)))
        return pictures[-1]

    grid = read_grid(description, read_picture)
    picture_name = description.required("image").text()
    if not (is_plain(name) and is_plain(picture_name)):
        return grid, None
    return grid, ImageFiles(name, read(name), picture_name, pictures[-1])


def _check_pictures(node: Node, maps: Iterable[Map]) -> None:
    """Check the total size of the pictures of a scene, the last of which `node` describes.

    Raises:
        DataFileError: They are too large.
    """
    pixels = sum(each.grid.cells.size for each in maps if each.grid)
    if pixels > _MAX_PIXELS:
        raise node.error(f"the pictures of the scene have more than {_MAX_PIXELS} pixels in total")


def _bounds(node: Node, points: Iterable[Point]) -> tuple[Point, Point]:
    """Return the lower left and the upper right corner of the rectangle around `points`."""
    x, y = ([*values] for values in zip(*points, strict=True))
    low, high = (min(x), min(y)), (max(x), max(y))
    for side in (high[0] - low[0], high[1] - low[1]):
        if not 0.0 < side <= _MAX_SIDE:
            raise node.error(f"a side of {side:g} m is not within 0 to {_MAX_SIDE:g} m")
    return low, high


def _walls(node: Node) -> Iterator[Wall]:
    values = [each.number() for each in node.items(2 * _MAX_WALLS + 2)]
    if len(values) < 4 or len(values) % 2:
        raise node.error("must be [x1, y1, x2, y2], or more corners in pairs of x and y")
    for start, end in pairwise(zip(values[::2], values[1::2], strict=True)):
        yield Wall(*start, *end)


def _marks(node: Node) -> dict[str, Mark]:
    nodes = list(_items(node, "marks", MAX_MARKS))
    marks = []
    for place, each in enumerate(nodes, start=1):
        each.check_keys(("number", "id", "type", "pose", "description"))
        id_, kind, description = each.get("id"), each.get("type"), each.get("description")
        marks.append(
            Mark(
                id=id_.integer(0, _UINT32) if id_ else place,
                number=each.required("number").text(),
                pose=_pose(each.required("pose")),
                kind=_KINDS[kind.choice(_KINDS)] if kind else MarkKind.BASE,
                description=description.text() if description else "",
            )
        )
    _all_different(nodes, "number", [mark.number for mark in marks])
    _all_different(nodes, "id", [mark.id for mark in marks])
    return {mark.number: mark for mark in marks}


def _predefined(tasks: Node, marks: Collection[str]) -> Iterator[woosh_task_pb2.RepeatTask]:
    for node in _items(tasks, "predefined", MAX_TASKS):
        node.check_keys(("id", "name", "steps", "times"))
        times = node.get("times")
        yield woosh_task_pb2.RepeatTask(
            times=times.integer(1, _INT32) if times else 1, task_set=_task_set(node, marks)
        )


def _calls(tasks: Node, marks: Collection[str]) -> Iterator[woosh_task_pb2.CallTask]:
    info = woosh_task_pb2.CallInfo
    for node in _items(tasks, "calls", MAX_TASKS):
        node.check_keys(("id", "name", "steps", "button"))
        button = node.required("button").check_keys(("mac", "key"))
        caller = info.Caller(
            mac_addr=button.required("mac").text(),
            key_id=button.required("key").integer(1, _UINT32),
        )
        call = info(type=info.kOr, events=[info.CallEvent(caller=caller, release=1)])
        yield woosh_task_pb2.CallTask(call_info=call, task_set=_task_set(node, marks))


def _task_set(node: Node, marks: Collection[str]) -> woosh_task_pb2.WooshTaskSet:
    number, name = node.required("id").integer(1, _INT32), node.required("name").text()
    tasks = []
    for index, step in enumerate(node.required("steps").items(MAX_TASKS), start=1):
        step.check_keys(("mark", "type", "direction", "wait"))
        mark, kind = step.required("mark"), step.get("type")
        direction, wait = step.get("direction"), step.get("wait")
        if mark.text() not in marks:
            raise mark.error(f"no map of the scene has a mark {mark.text()}")
        base = task_pb2.TaskBase(
            id=index,
            name=f"{name} {index}",
            mark_no=mark.text(),
            type=_TASK_TYPES[kind.choice(_TASK_TYPES) if kind else "pick"],
            wait_time=wait.integer(-1, _INT32) if wait else 0,
        )
        if direction:
            base.direction = _DIRECTIONS[direction.choice(_DIRECTIONS)]
        custom = woosh_task_pb2.WooshTask.Custom(executable=True)
        tasks.append(woosh_task_pb2.WooshTask(base=base, custom=custom))
    if not tasks:
        raise node.error("a task set needs at least one step")
    base_of_set = task_pb2.TaskSetBase(id=number, name=name, no=str(number), adapter="woosh")
    return woosh_task_pb2.WooshTaskSet(base=base_of_set, tasks=tasks)


def _items(node: Node, key: str, most: int) -> Iterator[Node]:
    found = node.get(key)
    return found.items(most) if found else iter(())


def _pose(node: Node) -> Pose:
    return Pose(*node.numbers("x, y, theta"))


def _all_different(nodes: Sequence[Node], key: str, values: Sequence[Hashable]) -> None:
    seen = set()
    for node, value in zip(nodes, values, strict=True):
        if value in seen:
            raise node.error(f"{key} {value} is used twice")
        seen.add(value)


MAX_SCENES = 20
"""Number of known scenes from which on new ones are refused."""

_SHIPPED = tuple(Path(__file__).parents[1] / "data" / name for name in ("wooshmap", "scenex"))
_START_CLEARANCE = 0.6
"""Minimum clearance of a start place that the scene does not define, in metres."""


def known_scenes(given: Iterable[Path] = ()) -> tuple[dict[str, Scene], Scene]:
    """Return the scenes that a robot knows, by name, and the one in which it starts.

    Args:
        given: Folders or files of further scenes, as for `load_scene`. They replace shipped ones of
            the same name. The robot starts in the first of them.

    Raises:
        DataFileError: A file cannot be used.
    """
    shipped, own = [_loaded(path) for path in _SHIPPED], [_loaded(path) for path in given]
    return {scene.name: scene for scene in shipped + own}, (own or shipped)[0]


def start(scene: Scene) -> tuple[Map, Pose]:
    """Return the map and the pose where a robot starts: any free place by default."""
    area = scene.map(scene.start_map) or scene.maps[0]
    return area, scene.start or Pose(*_free_place(area))


def _free_place(area: Map) -> Point:
    """Return the origin, a mark, or the place of a grid with the most room around it."""
    for point in ((0.0, 0.0), *(mark.pose.point for mark in area.marks.values())):
        if area.contains(*point) and area.clearance(*point) >= _START_CLEARANCE:
            return point
    return area.grid.roomiest() if area.grid else (0.0, 0.0)


def _loaded(path: Path) -> Scene:
    """Return a new scene. Its maps are shared, so that their planners are computed only once."""
    scene = _read_once(path) if path in _SHIPPED else load_scene(path)
    return dataclasses.replace(scene, maps=list(scene.maps), files={})


@lru_cache
def _read_once(path: Path) -> Scene:
    return load_scene(path)
