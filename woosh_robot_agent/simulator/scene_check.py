"""Find errors in the files of a scene, e.g. unreadable files, and marks that cannot be reached."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.pb.util import task_pb2
from woosh_robot_agent.simulator.profile import Profile
from woosh_robot_agent.simulator.scenes import robot_files
from woosh_robot_agent.simulator.scenes.action_groups import ACTION_GROUPS, read_action_groups
from woosh_robot_agent.simulator.scenes.files import load_scene, read_robot_folder, start_place
from woosh_robot_agent.simulator.scenes.scene import (
    MAP_FILE,
    SCENE_INDEX,
    TASK_INFO,
    Scene,
)
from woosh_robot_agent.simulator.world.geometry import Pose, hull, outer_radius
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.world.planner import PATH_MARGIN, SearchBudgetError, planner


def check_scene(path: Path, profile: Profile) -> list[str]:
    """Return a line for each error in a scene; an empty list if there is none.

    Args:
        path: folder of the scene, or its YAML file: `scene.yaml`, or a map of map_server.
        profile: profile of the robot that is to drive there.
    """
    try:
        is_robot_folder = (path / SCENE_INDEX).is_file()
        unreadable = list(_unreadable_files(path)) if is_robot_folder else []
        # The marks on a map can only be checked if all maps can be read.
        return unreadable or list(_unusable_places(load_scene(path), profile))
    except DataFileError as error:
        return [str(error)]
    except OSError as error:
        return [f"{path}: {error.strerror}"]


def _unreadable_files(folder: Path) -> Iterator[str]:
    """Yield an error for each invalid file in a robot's folder, and each map not in its index."""
    files = read_robot_folder(folder)
    maps = robot_files.map_names(files[SCENE_INDEX])
    yield from _errors_of(lambda: read_action_groups(files.get(ACTION_GROUPS, b"")))
    yield from _errors_of(lambda: robot_files.read_task_info(files))
    for name in maps:
        yield from _unreadable_map_files(name, files)
    for other in sorted(folder.glob(f"*/{MAP_FILE}")):
        if other.parent.name not in maps:
            yield f"{other.parent.name}: {SCENE_INDEX} does not name this map"


def _unreadable_map_files(name: str, files: Mapping[str, bytes]) -> Iterator[str]:
    """Yield an error for each invalid file in the folder of a map."""

    def read_keepout() -> None:
        grid = robot_files.read_map_picture(name, files)
        robot_files.read_map_keepout(name, files, grid)

    # The file of the keep-out areas can only be checked if the map can be read.
    picture_errors = _errors_of(lambda: robot_files.read_map_picture(name, files))
    yield from picture_errors or _errors_of(read_keepout)
    yield from _errors_of(lambda: robot_files.read_mark_info(name, files))
    yield from _errors_of(lambda: robot_files.check_unused_files(name, files))


def _errors_of(read: Callable[[], object]) -> list[str]:
    """Call a function that reads a file. Return its error, or an empty list without one."""
    try:
        read()
    except DataFileError as error:
        return [str(error)]
    return []


def _unusable_places(scene: Scene, profile: Profile) -> Iterator[str]:
    """Yield an error for each part of a scene that a robot cannot use: start, marks and tasks.

    Only the marks on the map of the start must be reachable.
    """
    first, pose = start_place(scene)
    outline = hull(profile.model.outline)
    if not first.contains(*pose.point) or first.gap(outline, pose) < 0.0:
        yield f"map {first.name}: the robot cannot stand at the start {pose}"
    for area in scene.maps:
        for mark in area.marks.values():
            where = f"map {area.name}: mark {mark.number} at {mark.pose}"
            if not area.contains(*mark.pose.point):
                yield f"{where} is not on known floor"
            elif area.gap(outline, mark.pose) < 0.0:
                yield f"{where} is so close to a wall that the robot cannot stand there"
            elif area.grid and area.grid.kept_out(*mark.pose.point):
                yield f"{where} is in a keep-out area"
            elif area is first and not _can_drive(area, profile, pose, mark.pose):
                yield f"{where} cannot be reached from the start {pose}"
    yield from _unusable_tasks(scene)


def _can_drive(area: Map, profile: Profile, here: Pose, there: Pose) -> bool:
    """Return True if the planner finds a path before its computation time is used up."""
    routes = planner(area, outer_radius(profile.model.outline) + PATH_MARGIN)
    try:
        return routes.plan(here.point, there.point) is not None
    except SearchBudgetError:
        return False


def _unusable_tasks(scene: Scene) -> Iterator[str]:
    """Yield an error for each task type without actions, and each task whose mark is on no map."""
    for kind in task_pb2.Type.values():
        if kind and not scene.action_groups.numbers(kind):  # 0 is the undefined type
            yield f"{ACTION_GROUPS}: it has no actions for tasks of type {kind}"
    marks = {number for area in scene.maps for number in area.marks}
    task_sets = [each.task_set for each in scene.predefined.repeat_tasks]
    task_sets += [each.task_set for each in scene.calls.call_tasks]
    for task_set in task_sets:
        for task in task_set.tasks:
            if task.base.mark_no not in marks:
                yield (
                    f"{TASK_INFO}: task set {task_set.base.id}: no map has its mark "
                    f"{task.base.mark_no}"
                )
