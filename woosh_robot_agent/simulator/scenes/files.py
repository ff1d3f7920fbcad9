"""Reads scenes from files: a folder with `scene.yaml` and pictures, or maps of nav2's map_server.

`scene.yaml` has the keys of `SceneEntry`; docs/simulator.md has an example. Lengths are in metres,
angles in radians, poses are [x, y, theta].

Without `scene.yaml`, each map of map_server in the folder becomes a map of the scene, named after
its YAML file. Its marks come from a file NAME.mark_info.data, if there is one.

The shipped scenes are in the folder `data/`. `wooshmap` is a hall with two partitions, three
pillars and a gate. `scenex` is the same hall furnished differently, with a second, empty floor.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar

from google.protobuf.message import DecodeError, Message

from woosh_robot_agent.data_files import Between, DataFileError, load_yaml, place, structure
from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.pb.task import task_pb2, woosh_task_pb2
from woosh_robot_agent.simulator.scenes.scene import (
    MARK_INFO,
    SCENE_FILE,
    Scene,
    has_pose,
    is_plain,
    marks_of,
    other_marks,
)
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall
from woosh_robot_agent.simulator.world.maps import ImageFiles, Map, Mark, MarkKind

if TYPE_CHECKING:  # numpy and scipy load slowly, and few maps have a grid
    from woosh_robot_agent.simulator.world.grid import Grid

Read = Callable[[str], bytes]
"""Returns the content of the file with the given name, or raises `DataFileError`."""

MAX_MAPS = 50
"""Maximum number of maps of a scene."""

MAX_MARKS = 5000
"""Maximum number of marks of a map."""

_MAX_TASKS = 200
"""Maximum number of task sets of one kind, and of tasks in a set."""

_MAX_WALLS = 1000
"""Laser and planner check each wall. A map with more walls needs a picture instead."""

_MAX_FILE_BYTES = 64 * 1024 * 1024

MAX_PIXELS = 32 * 1024 * 1024
"""Limit for all pictures of a scene together. Reading them blocks the simulator."""

_MAX_SIDE = 500.0
"""Maximum length of a side of a map, in metres."""

_DEFAULT_FLOOR = "1F"

_INT32 = 2**31 - 1

_Id = Annotated[int, Between(0, 2**32 - 1)]
_Positive = Annotated[int, Between(1, _INT32)]


class _Pose(NamedTuple):
    x: float
    y: float
    theta: float


class _Corners(NamedTuple):
    x1: float
    y1: float
    x2: float
    y2: float


@dataclass(frozen=True)
class StartEntry:
    """Where the robot starts.

    Attributes:
        pose: Its pose.
        map: Name of the map; default: the first one.
    """

    pose: _Pose
    map: str = ""


@dataclass(frozen=True)
class MarkEntry:
    """A mark of a map.

    Attributes:
        number: Number by which tasks name it.
        pose: Pose of a robot that stands at it.
        id: Its id; default: its index in the list, from 1.
        type: Kind of mark.
        description: Description for people.
    """

    number: str
    pose: _Pose
    id: _Id | None = None
    type: MarkKind = MarkKind.BASE
    description: str = ""
    where: str = place()


@dataclass(frozen=True)
class MapEntry:
    """A map, with an image, walls or both.

    Attributes:
        name: Its name.
        id: Its id; default: the first one from 1 that no map has.
        floor: Name of the floor; default: 1F.
        version: Its version; default: 1.
        image: YAML file of a map of map_server, with its PNG or PGM beside it.
        area: Two corners of the mapped area: [x1, y1, x2, y2]; default: around everything.
        walls: Polylines: x and y of each corner.
        marks: Its marks.
        mark_info: Instead of marks: a file with a serialised `woosh.map.mark.MarkInfo`.
    """

    name: str
    id: _Id | None = None
    floor: str = ""
    version: _Positive | None = None
    image: str = ""
    area: _Corners | None = None
    walls: Annotated[tuple[tuple[float, ...], ...], Between(0, _MAX_WALLS)] = ()
    marks: Annotated[tuple[MarkEntry, ...], Between(0, MAX_MARKS)] = ()
    mark_info: str = ""
    where: str = place()

    def __post_init__(self) -> None:
        if self.marks and self.mark_info:
            raise ValueError("give marks or mark_info, not both")
        if not (self.image or self.walls):
            raise ValueError("a map needs an image or walls")


@dataclass(frozen=True)
class StepEntry:
    """A task of a task set.

    Attributes:
        mark: Number of its mark.
        type: Kind of task.
        direction: Direction of a task that carries goods.
        wait: Time to wait after the task, in seconds; -1 until a client tells it to continue.
    """

    mark: str
    type: Literal["pick", "parking", "charge", "carry"] = "pick"
    direction: Literal["feeding", "cutting"] | None = None
    wait: Annotated[int, Between(-1, _INT32)] = 0
    where: str = place()


@dataclass(frozen=True)
class ButtonEntry:
    """A call button.

    Attributes:
        mac: Its address.
        key: Number of the key that is pressed.
    """

    mac: str
    key: Annotated[int, Between(1, 2**32 - 1)]


@dataclass(frozen=True)
class TaskSetEntry:
    """A task set.

    Attributes:
        id: Its id.
        name: Its name.
        steps: Its tasks.
        times: Number of repetitions, of a set for ExecPreTask.
        button: Button that starts it, of a set for call buttons.
    """

    id: _Positive
    name: str
    steps: Annotated[tuple[StepEntry, ...], Between(1, _MAX_TASKS)]
    times: _Positive = 1
    button: ButtonEntry | None = None
    where: str = place()


_TaskSets = Annotated[tuple[TaskSetEntry, ...], Between(0, _MAX_TASKS)]


@dataclass(frozen=True)
class TasksEntry:
    """The task sets of the scene.

    Attributes:
        predefined: Task sets for ExecPreTask.
        calls: Task sets for call buttons, with the same keys.
    """

    predefined: _TaskSets = ()
    calls: _TaskSets = ()


@dataclass(frozen=True)
class SceneEntry:
    """The content of `scene.yaml`.

    Attributes:
        maps: The maps, the default one first.
        name: Name of the scene; default: that of the folder.
        start: Initial pose of the robot; default: any free place.
        tasks: Task sets.
        task_info: Instead of tasks: a file with a serialised `woosh.task.TaskInfo`.
    """

    maps: Annotated[tuple[MapEntry, ...], Between(1, MAX_MAPS)]
    name: str = ""
    start: StartEntry | None = None
    tasks: TasksEntry | None = None
    task_info: str = ""

    def __post_init__(self) -> None:
        if self.tasks and self.task_info:
            raise ValueError("give tasks or task_info, not both")


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
        entry = structure(SceneEntry, load_yaml(SCENE_FILE, read(SCENE_FILE)), SCENE_FILE)
        return _scene(entry, (entry.name if use_own_name else "") or name, read)
    maps = read_maps(names, read)
    return Scene(name, maps) if maps else None


def read_maps(names: Collection[str], read: Read) -> list[Map]:
    """Read the maps of map_server among some files.

    Raises:
        DataFileError: A file cannot be used.
    """
    maps: list[Map] = []
    for file in sorted(names):
        if Path(file).suffix not in (".yaml", ".yml"):
            continue
        content = load_yaml(file, read(file))
        if not isinstance(content, dict) or not content.get("image"):
            continue
        stem = Path(file).stem
        mark_info = stem + MARK_INFO if stem + MARK_INFO in names else ""
        entry = MapEntry(name=stem, image=file, mark_info=mark_info, where=file)
        maps.append(_map(entry, iter([len(maps) + 1]), read, content))
        _check_pictures(file, maps)
        if stem in [other.name for other in maps[:-1]]:
            raise DataFileError(f"{file}: another file has the map name {stem} too")
    return maps


def _scene(entry: SceneEntry, name: str, read: Read) -> Scene:
    maps: list[Map] = []
    # Not from 0, with which robots report a pose that belongs to no map.
    given = [each.id for each in entry.maps]
    free_ids = (number for number in count(1) if number not in given)
    for each in entry.maps:
        maps.append(_map(each, free_ids, read))
        _check_pictures(each.where, maps)
    places = [each.where for each in entry.maps]
    _all_different(places, "name", [each.name for each in maps])
    _all_different(places, "id", [each.id for each in maps])
    scene = Scene(name, maps)
    if entry.start:
        scene.start, scene.start_map = Pose(*entry.start.pose), entry.start.map
        known = [each.name for each in maps]
        if scene.start_map and scene.start_map not in known:
            raise DataFileError(
                f"{SCENE_FILE}: start.map: {scene.start_map!r} is not one of {', '.join(known)}"
            )
    if entry.task_info:
        info = _read_task_info(entry.task_info, read)
        scene.predefined.repeat_tasks.extend(info.repeat_tasks)
        scene.calls.call_tasks.extend(info.call_tasks)
    if entry.tasks:
        marks = {number for each in maps for number in each.marks}
        scene.predefined.repeat_tasks.extend(
            woosh_task_pb2.RepeatTask(times=each.times, task_set=_task_set(each, marks))
            for each in entry.tasks.predefined
        )
        scene.calls.call_tasks.extend(_call(each, marks) for each in entry.tasks.calls)
    return scene


def _map(entry: MapEntry, free_ids: Iterator[int], read: Read, content: Any = None) -> Map:
    """Return the map that an entry describes.

    Args:
        entry: The entry.
        free_ids: Ids for maps without one.
        read: Returns the content of a file.
        content: Content of the file `image`, None to read it.
    """
    walls = tuple(_walls(entry))
    if len(walls) > _MAX_WALLS:
        text = f"{len(walls)} walls are more than {_MAX_WALLS}"
        raise DataFileError(f"{entry.where}.walls: {text}")
    info = read_mark_info(entry.mark_info, read) if entry.mark_info else mark_pb2.MarkInfo()
    marks = marks_of(info) if entry.mark_info else _marks(entry)
    grid, files = None, None
    if entry.image:
        content = content or load_yaml(entry.image, read(entry.image))
        grid, files = _grid(entry.image, content, read)
    if entry.area:
        x1, y1, x2, y2 = entry.area
        corners = [(x1, y1), (x2, y2)]
    else:
        corners = [point for wall in walls for point in ((wall.x1, wall.y1), (wall.x2, wall.y2))]
        corners += [mark.pose.point for mark in marks.values()] if walls else []
        corners += [grid.low, grid.high] if grid else []
    low, high = _bounds(entry.where, corners)
    return Map(
        id=next(free_ids) if entry.id is None else entry.id,
        name=entry.name,
        floor=entry.floor or info.floor_name or _DEFAULT_FLOOR,
        version=entry.version or min(max(1, info.version), _INT32),
        low=low,
        high=high,
        walls=walls,
        marks=marks,
        grid=grid,
        image=files,
        other_marks=other_marks(info),
    )


def _grid(name: str, content: Any, read: Read) -> tuple[Grid, ImageFiles | None]:
    """Return a grid and its files, or None for these if their names are paths."""
    # numpy, scipy and Pillow load in a third of a second, which only pictures need.
    from woosh_robot_agent.simulator.scenes.map_server import read_grid

    folder = Path(name).parent
    grid, picture_name, picture = read_grid(name, content, lambda file: read(str(folder / file)))
    if not (is_plain(name) and is_plain(picture_name)):
        return grid, None
    return grid, ImageFiles(name, read(name), picture_name, picture)


def _check_pictures(where: str, maps: Iterable[Map]) -> None:
    """Check the total size of the pictures of a scene, the last of which is described at `where`.

    Raises:
        DataFileError: They are too large.
    """
    if sum(each.grid.cells.size for each in maps if each.grid) > MAX_PIXELS:
        text = f"the pictures of the scene have more than {MAX_PIXELS} pixels in total"
        raise DataFileError(f"{where}: {text}")


def _bounds(where: str, points: Iterable[Point]) -> tuple[Point, Point]:
    """Return the lower left and the upper right corner of the rectangle around `points`."""
    x, y = ([*values] for values in zip(*points, strict=True))
    low, high = (min(x), min(y)), (max(x), max(y))
    for side in (high[0] - low[0], high[1] - low[1]):
        if not 0.0 < side <= _MAX_SIDE:
            text = f"a side of {side:g} m is not within 0 to {_MAX_SIDE:g} m"
            raise DataFileError(f"{where}: {text}")
    return low, high


def _walls(entry: MapEntry) -> Iterator[Wall]:
    for number, line in enumerate(entry.walls):
        if len(line) < 4 or len(line) % 2:
            text = "must be [x1, y1, x2, y2], or more corners in pairs of x and y"
            raise DataFileError(f"{entry.where}.walls[{number}]: {text}")
        for start, end in pairwise(zip(line[::2], line[1::2], strict=True)):
            yield Wall(*start, *end)


def _marks(entry: MapEntry) -> dict[str, Mark]:
    marks = [
        Mark(
            number if each.id is None else each.id,
            each.number,
            Pose(*each.pose),
            each.type,
            each.description,
        )
        for number, each in enumerate(entry.marks, start=1)
    ]
    places = [each.where for each in entry.marks]
    _all_different(places, "number", [mark.number for mark in marks])
    _all_different(places, "id", [mark.id for mark in marks])
    return {mark.number: mark for mark in marks}


def _call(entry: TaskSetEntry, marks: Collection[str]) -> woosh_task_pb2.CallTask:
    if entry.button is None:
        raise DataFileError(f"{entry.where}: button is missing")
    info = woosh_task_pb2.CallInfo
    caller = info.Caller(mac_addr=entry.button.mac, key_id=entry.button.key)
    call = info(type=info.kOr, events=[info.CallEvent(caller=caller, release=1)])
    return woosh_task_pb2.CallTask(call_info=call, task_set=_task_set(entry, marks))


def _task_set(entry: TaskSetEntry, marks: Collection[str]) -> woosh_task_pb2.WooshTaskSet:
    tasks = []
    for number, step in enumerate(entry.steps, start=1):
        if step.mark not in marks:
            text = f"no map of the scene has a mark {step.mark}"
            raise DataFileError(f"{step.where}.mark: {text}")
        base = task_pb2.TaskBase(
            id=number,
            name=f"{entry.name} {number}",
            mark_no=step.mark,
            type=f"k{step.type.title()}",
            direction=f"k{step.direction.title()}" if step.direction else None,
            wait_time=step.wait,
        )
        custom = woosh_task_pb2.WooshTask.Custom(executable=True)
        tasks.append(woosh_task_pb2.WooshTask(base=base, custom=custom))
    number = entry.id
    base_of_set = task_pb2.TaskSetBase(id=number, name=entry.name, no=str(number), adapter="woosh")
    return woosh_task_pb2.WooshTaskSet(base=base_of_set, tasks=tasks)


def _all_different(places: Sequence[str], key: str, values: Sequence[Hashable]) -> None:
    seen = set()
    for where, value in zip(places, values, strict=True):
        if value in seen:
            raise DataFileError(f"{where}: {key} {value} is used twice")
        seen.add(value)


_M = TypeVar("_M", bound=Message)
"""Class of the message in a file."""


def _read_task_info(name: str, read: Read) -> woosh_task_pb2.TaskInfo:
    """Read a file with the tasks of a scene.

    Raises:
        DataFileError: The file cannot be used.
    """
    info = _message(name, read, woosh_task_pb2.TaskInfo)
    counts = [len(info.repeat_tasks), len(info.call_tasks)]
    counts += [len(each.task_set.tasks) for each in info.repeat_tasks]
    counts += [len(each.task_set.tasks) for each in info.call_tasks]
    if max(counts) > _MAX_TASKS:
        raise DataFileError(f"{name}: {max(counts)} tasks are more than {_MAX_TASKS}")
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
