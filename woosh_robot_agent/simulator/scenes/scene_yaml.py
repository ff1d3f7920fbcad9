"""Read scenes that people write: a folder with `scene.yaml`, and maps of nav2's map_server.

`scene.yaml` has the keys of `SceneEntry`; docs/simulator.md has an example. Lengths are in metres,
angles in radians, poses are [x, y, theta].

Without `scene.yaml`, each map of map_server in the folder becomes a map of the scene, named after
its YAML file and without marks.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from woosh_robot_agent.data_files import Between, DataFileError, load_yaml, source_field, structure
from woosh_robot_agent.pb.task import task_pb2, woosh_task_pb2
from woosh_robot_agent.simulator.scenes.robot_files import (
    DEFAULT_FLOOR,
    INT32,
    MAX_MAPS,
    MAX_MARKS,
    MAX_TASKS,
    FileReader,
    check_map_name,
    check_pixels,
    check_sides,
    check_unique,
)
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.geometry import Pose, Wall
from woosh_robot_agent.simulator.world.maps import Map, Mark, MarkKind

if TYPE_CHECKING:  # numpy and scipy load slowly, and few maps have a grid
    from woosh_robot_agent.simulator.world.grid import Grid

SCENE_FILE = "scene.yaml"
"""Name of the file that describes a scene."""

_MAX_WALLS = 1000
"""Maximum number of walls of a map: laser and planner check each wall. A map with more walls needs
a picture instead."""

_CallInfo = woosh_task_pb2.CallInfo

_Id = Annotated[int, Between(0, 2**32 - 1)]
_Positive = Annotated[int, Between(1, INT32)]


class _Pose(NamedTuple):
    x: float
    y: float
    theta: float


class _Corners(NamedTuple):
    """Two opposite corners of an area."""

    x1: float
    y1: float
    x2: float
    y2: float


@dataclass(frozen=True)
class StartEntry:
    """The pose at which the robot starts.

    Attributes:
        pose: pose of the robot.
        map: name of the map; default: the first map.
    """

    pose: _Pose
    map: str = ""


@dataclass(frozen=True)
class MarkEntry:
    """A mark of a map.

    Attributes:
        number: number by which tasks name the mark.
        pose: pose of a robot that stands at the mark.
        id: id of the mark; default: its index in the list, from 1.
        type: kind of mark.
        description: description for people.
        source: file and place of the entry, for errors; not a key of the file.
    """

    number: str
    pose: _Pose
    id: _Id | None = None
    type: MarkKind = MarkKind.BASE
    description: str = ""
    source: str = source_field()


@dataclass(frozen=True)
class MapEntry:
    """A map, with an image, walls or both.

    Attributes:
        name: name of the map.
        id: id of the map; default: the first id from 1 that no map has.
        floor: name of the floor; default: 1F.
        version: version of the map; default: 1.
        image: YAML file of a map of map_server, with its PNG or PGM beside it.
        area: two corners of the mapped area: [x1, y1, x2, y2]; default: around everything.
        walls: polylines: x and y of each corner.
        marks: marks of the map.
        source: file and place of the entry, for errors; not a key of the file.
    """

    name: Annotated[str, check_map_name]
    id: _Id | None = None
    floor: str = ""
    version: _Positive | None = None
    image: str = ""
    area: _Corners | None = None
    walls: Annotated[tuple[tuple[float, ...], ...], Between(0, _MAX_WALLS)] = ()
    marks: Annotated[tuple[MarkEntry, ...], Between(0, MAX_MARKS)] = ()
    source: str = source_field()

    def __post_init__(self) -> None:
        if not (self.image or self.walls):
            raise ValueError("a map needs an image or walls")


@dataclass(frozen=True)
class StepEntry:
    """A task of a task set: an item of its `steps`.

    Attributes:
        mark: number of the target mark.
        type: kind of task.
        direction: direction of a task that carries goods; default: none.
        wait: time to wait after the task, in seconds; -1 until a client tells it to continue.
        source: file and place of the entry, for errors; not a key of the file.
    """

    mark: str
    type: Literal["pick", "parking", "charge", "carry"] = "pick"
    direction: Literal["feeding", "cutting"] | None = None
    wait: Annotated[int, Between(-1, INT32)] = 0
    source: str = source_field()


@dataclass(frozen=True)
class ButtonEntry:
    """A call button.

    Attributes:
        mac: MAC address of the button.
        key: number of the key that is pressed.
    """

    mac: str
    key: Annotated[int, Between(1, 2**32 - 1)]


@dataclass(frozen=True)
class TaskSetEntry:
    """A task set.

    Attributes:
        id: id of the task set.
        name: name of the task set.
        steps: tasks of the set.
        times: for predefined sets: number of times that the set is run.
        button: for sets of call buttons: button that starts the set.
        source: file and place of the entry, for errors; not a key of the file.
    """

    id: _Positive
    name: str
    steps: Annotated[tuple[StepEntry, ...], Between(1, MAX_TASKS)]
    times: _Positive = 1
    button: ButtonEntry | None = None
    source: str = source_field()


_TaskSets = Annotated[tuple[TaskSetEntry, ...], Between(0, MAX_TASKS)]


@dataclass(frozen=True)
class TasksEntry:
    """The task sets of the scene.

    Attributes:
        predefined: task sets that ExecPreTask starts.
        calls: task sets that call buttons start, with the same keys as those in `predefined`.
    """

    predefined: _TaskSets = ()
    calls: _TaskSets = ()


@dataclass(frozen=True)
class SceneEntry:
    """The content of `scene.yaml`.

    Attributes:
        maps: the maps, the default map first.
        name: name of the scene; default: the name of the folder.
        start: initial pose of the robot; default: any free place.
        tasks: task sets.
    """

    maps: Annotated[tuple[MapEntry, ...], Between(1, MAX_MAPS)]
    name: str = ""
    start: StartEntry | None = None
    tasks: TasksEntry | None = None


def read_scene_yaml(name: str, read: FileReader) -> Scene:
    """Read the scene that `scene.yaml` describes.

    Args:
        name: name of the scene, unless `scene.yaml` has one.
        read: reads `scene.yaml` and the files that it names.
    """
    entry = structure(SceneEntry, load_yaml(SCENE_FILE, read(SCENE_FILE)), SCENE_FILE)
    return _scene(entry, entry.name or name, read)


def read_maps(names: Collection[str], read: FileReader) -> list[Map]:
    """Read the maps of map_server among some files: YAML files with a key `image`.

    Args:
        names: names of the files.
        read: reads one of the files.
    """
    maps: list[Map] = []
    for file in sorted(names):
        if Path(file).suffix not in (".yaml", ".yml"):
            continue
        content = load_yaml(file, read(file))
        if not isinstance(content, dict) or not content.get("image"):
            continue
        stem = Path(file).stem
        entry = MapEntry(name=stem, image=file, source=file)
        maps.append(_map(entry, len(maps) + 1, read))
        check_pixels(file, maps)
        if stem in [other.name for other in maps[:-1]]:
            raise DataFileError(f"{file}: another file has the map name {stem} too")
    return maps


def _scene(entry: SceneEntry, name: str, read: FileReader) -> Scene:
    """Return the scene called `name` from the content of `scene.yaml`."""
    maps: list[Map] = []
    # Ids start from 1, because robots report the map id 0 with a pose that belongs to no map.
    given = [each.id for each in entry.maps]
    free_ids = (number for number in count(1) if number not in given)
    for each in entry.maps:
        maps.append(_map(each, next(free_ids) if each.id is None else each.id, read))
        check_pixels(each.source, maps)  # the limit is for all maps together
    places = [each.source for each in entry.maps]
    check_unique(places, "name", [each.name for each in maps])
    check_unique(places, "id", [each.id for each in maps])
    scene = Scene(name, maps)
    if entry.start:
        scene.start, scene.start_map = Pose(*entry.start.pose), entry.start.map
        known = [each.name for each in maps]
        if scene.start_map and scene.start_map not in known:
            raise DataFileError(
                f"{SCENE_FILE}: start.map: {scene.start_map!r} is not one of {', '.join(known)}"
            )
    if entry.tasks:
        marks = {number for each in maps for number in each.marks}
        scene.predefined.repeat_tasks.extend(
            woosh_task_pb2.RepeatTask(times=each.times, task_set=_task_set(each, marks))
            for each in entry.tasks.predefined
        )
        scene.calls.call_tasks.extend(_call_task(each, marks) for each in entry.tasks.calls)
    return scene


def _map(entry: MapEntry, id_: int, read: FileReader) -> Map:
    """Return the map that an entry describes, with the id `id_`; `read` reads its image."""
    walls = tuple(_walls(entry))
    if len(walls) > _MAX_WALLS:  # a polyline has several walls
        text = f"{len(walls)} walls are more than {_MAX_WALLS}"
        raise DataFileError(f"{entry.source}.walls: {text}")
    marks = _marks(entry)
    grid = _grid(entry.image, read) if entry.image else None
    if entry.area:
        x1, y1, x2, y2 = entry.area
        corners = [(x1, y1), (x2, y2)]
    else:
        corners = [point for wall in walls for point in ((wall.x1, wall.y1), (wall.x2, wall.y2))]
        # Without walls, the area is that of the image, even if a mark lies outside.
        corners += [mark.pose.point for mark in marks.values()] if walls else []
        corners += [grid.low, grid.high] if grid else []
    x, y = zip(*corners, strict=True)
    low, high = (min(x), min(y)), (max(x), max(y))
    check_sides(entry.source, low, high)
    return Map(
        id=id_,
        name=entry.name,
        floor=entry.floor or DEFAULT_FLOOR,
        version=entry.version or 1,
        low=low,
        high=high,
        walls=walls,
        marks=marks,
        grid=grid,
    )


def _grid(name: str, read: FileReader) -> Grid:
    """Return the grid of a map of map_server, whose YAML file is `name`."""
    # numpy, scipy and Pillow load in a third of a second, which only pictures need.
    from woosh_robot_agent.simulator.scenes.map_server import read_grid

    folder = Path(name).parent
    return read_grid(name, load_yaml(name, read(name)), lambda file: read(str(folder / file)))


def _walls(entry: MapEntry) -> Iterator[Wall]:
    """Yield the walls of a map: one for each section of its polylines."""
    for number, line in enumerate(entry.walls):
        if len(line) < 4 or len(line) % 2:
            text = "must be [x1, y1, x2, y2], or more corners in pairs of x and y"
            raise DataFileError(f"{entry.source}.walls[{number}]: {text}")
        for start, end in pairwise(zip(line[::2], line[1::2], strict=True)):
            yield Wall(*start, *end)


def _marks(entry: MapEntry) -> dict[str, Mark]:
    """Return the marks of a map, by number; raise DataFileError if a number or id is used twice."""
    marks = [
        Mark(
            id=index if each.id is None else each.id,
            number=each.number,
            pose=Pose(*each.pose),
            kind=each.type,
            description=each.description,
        )
        for index, each in enumerate(entry.marks, start=1)
    ]
    places = [each.source for each in entry.marks]
    check_unique(places, "number", [mark.number for mark in marks])
    check_unique(places, "id", [mark.id for mark in marks])
    return {mark.number: mark for mark in marks}


def _call_task(entry: TaskSetEntry, marks: Collection[str]) -> woosh_task_pb2.CallTask:
    """Return a task set for a call button."""
    if entry.button is None:
        raise DataFileError(f"{entry.source}: button is missing")
    caller = _CallInfo.Caller(mac_addr=entry.button.mac, key_id=entry.button.key)
    # `release` is the id of the task after which the button is released: the first one.
    event = _CallInfo.CallEvent(caller=caller, release=1)
    call = _CallInfo(type=_CallInfo.kOr, events=[event])
    return woosh_task_pb2.CallTask(call_info=call, task_set=_task_set(entry, marks))


def _task_set(entry: TaskSetEntry, marks: Collection[str]) -> woosh_task_pb2.WooshTaskSet:
    """Return a task set, whose tasks are numbered from 1; `marks` has the numbers of all marks."""
    tasks = []
    for number, step in enumerate(entry.steps, start=1):
        if step.mark not in marks:
            text = f"no map of the scene has a mark {step.mark}"
            raise DataFileError(f"{step.source}.mark: {text}")
        base = task_pb2.TaskBase(
            id=number,
            name=f"{entry.name} {number}",
            mark_no=step.mark,
            type=f"k{step.type.title()}",  # the name of the type in `woosh.task.Type`
            direction=f"k{step.direction.title()}" if step.direction else None,
            wait_time=step.wait,
        )
        custom = woosh_task_pb2.WooshTask.Custom(executable=True)
        tasks.append(woosh_task_pb2.WooshTask(base=base, custom=custom))
    base_of_set = task_pb2.TaskSetBase(
        id=entry.id, name=entry.name, no=str(entry.id), adapter="woosh"
    )
    return woosh_task_pb2.WooshTaskSet(base=base_of_set, tasks=tasks)
