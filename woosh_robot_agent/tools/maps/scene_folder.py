"""The folder in which a scene is saved.

- The files of the robot, as it sent them: `scene.json` and others, and a folder for each map.
- `nav2/NAME.yaml` and `nav2/NAME.png` are the map NAME for nav2's map_server, and
  `nav2/NAME_keepout.yaml` is the mask of its keep-out areas.
- `marks/NAME.yaml` has the marks of the map, for people to edit.
- Hidden files and folders at the top level, such as `.git`, are not part of the scene, and stay.

The names come from a robot, which may call a file `../../.bashrc`. Characters that could make a
name a path out of the folder, or that some file systems do not permit, are percent-encoded.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from urllib.parse import unquote

import yaml
from google.protobuf.json_format import MessageToDict, ParseDict, ParseError
from google.protobuf.message import DecodeError

from woosh_robot_agent.data_files import Between, DataFileError, load_yaml, source_field, structure
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.map.mark_pb2 import MarkInfo, Storage
from woosh_robot_agent.robot.maps import MapError, map_files
from woosh_robot_agent.tools.options import ToolError

_UNSAFE = frozenset('/\\:*?"<>|%')
"""Characters that are encoded in file names; also `%`, so that different names stay different."""
_MAX_NAME = 200
"""Maximum length of a file name without suffix, in bytes. Most file systems have a limit of 255."""


def to_file_name(name: str) -> str:
    """Return a file name for the name of a scene, map or file; it differs for different names.

    Raises:
        ToolError: the name is empty or too long.
    """
    quoted = "".join(map(_quoted, name))
    if quoted.startswith("."):  # a hidden file, `.` or `..`
        quoted = f"%2E{quoted[1:]}"
    if not name or len(quoted.encode()) > _MAX_NAME:
        raise ToolError(
            f"the name {name[:50]!r} cannot be a file name: it is empty or too long; rename it on "
            "the robot"
        )
    return quoted


def _quoted(character: str) -> str:
    if character.isprintable() and character not in _UNSAFE:
        return character
    return "".join(f"%{byte:02X}" for byte in character.encode())


_TYPES = tuple(field.name for field in Storage.DESCRIPTOR.oneofs_by_name["category"].fields)
"""Types of marks: the categories of `woosh.map.mark.Storage`."""
_BASE = "base"
"""Type of a mark without a category."""
_MARKS, _OTHERS = "marks", "others"
"""Keys of a file of marks: the storage places, and all other marks."""
_MAX_MARKS_FILE = 8 * 1024 * 1024
"""Maximum size of a file of marks, in bytes."""
_MAX_MARKS = 100_000
"""Maximum number of marks in a file."""
_MAX_ID = 2**32 - 1
"""Greatest possible id of a mark."""
_HEADING = """\
# Marks of map {map}. Edit this file, then upload the folder: maps --ip ... upload --force FOLDER
#
# pose is where a robot stands at the mark: [x, y, theta], in m and rad. real is the pose of the
# place itself, if it differs. A mark without an id gets a free one.
# Types: {types}.
"""


def marks_as_yaml(info: MarkInfo, map_name: str) -> bytes:
    """Return the marks of a map as YAML."""
    heading = _HEADING.format(map=repr(map_name), types=", ".join((_BASE, *_TYPES)))
    content = {_MARKS: [_entry(storage) for storage in info.storages], _OTHERS: _other_marks(info)}
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None)
    return (heading + text).encode()


def read_marks(path: Path, old: MarkInfo) -> MarkInfo:
    """Return the marks in a YAML file; `old` itself if the file was not edited.

    Args:
        old: the robot's marks that were written to the file. Data that the file does not contain
            are taken from them.

    Raises:
        ToolError: the file cannot be used.
    """
    name = str(path)
    try:
        root = structure(_MarksFile, load_yaml(name, _read(path), _MAX_MARKS_FILE), name)
        storages = _storages(name, root.marks, old.storages)
        has_new_others = bool(root.others) and root.others != _other_marks(old)
        if not has_new_others and storages == list(old.storages):
            return old
        if has_new_others:
            new = MarkInfo(version=old.version)
            _parse_into(f"{name}: {_OTHERS}", root.others, new)
        else:
            new = MarkInfo()
            new.CopyFrom(old)
        del new.storages[:]
        new.storages.extend(storages)
    except DataFileError as error:
        raise ToolError(str(error)) from None
    return new


def _storages(name: str, entries: Iterable[Any], old: Iterable[Storage]) -> list[Storage]:
    """Return the marks of the file `name`; for an entry that was not edited, that of `old`.

    An edited or new mark without an id gets one above the highest id. The number and the id of an
    edited or new mark must be unique. Unedited marks may share theirs, as they do on the robot.

    Raises:
        DataFileError: an entry cannot be used; the text has its place.
    """
    old_by_number: dict[str, list[Storage]] = {}
    for storage in old:
        old_by_number.setdefault(storage.identity.no, []).append(storage)
    storages: list[Storage] = []
    changed: list[Storage] = []
    taken: set[str | int] = set()  # numbers and ids
    taken_by_changed: set[str | int] = set()
    for index, entry in enumerate(entries):
        where = f"{name}: {_MARKS}[{index}]"
        # `str`, because the number in a file may be anything
        known = old_by_number.get(str(entry.get("number")), []) if isinstance(entry, dict) else []
        before = next((each for each in known if _entry(each) == entry), None)
        if before is None:  # edited or new
            storage, forbidden = _storage(structure(_MarkEntry, entry, where)), taken
            changed.append(storage)
        else:
            storage, forbidden = before, taken_by_changed
            known.remove(before)  # a copy of the entry is a new mark
        number, id_ = storage.identity.no, storage.identity.id
        own = {number, id_ or number}  # 0 is no id
        if own & forbidden:
            raise DataFileError(f"{where}: number {number} or id {id_} is used twice")
        taken |= own
        if before is None:
            taken_by_changed |= own
        storages.append(storage)
    ids = {each.identity.id for each in storages}
    for storage in changed:
        if storage.identity.id:
            continue
        if max(ids) == _MAX_ID:
            text = f"the id {_MAX_ID} leaves none for the new mark {storage.identity.no}"
            raise DataFileError(f"{name}: {_MARKS}: {text}: give it an id")
        storage.identity.id = max(ids) + 1
        ids.add(storage.identity.id)
    return storages


def _entry(storage: Storage) -> dict[str, Any]:
    """Return a mark as an entry of a file of marks; the inverse of `_storage`."""
    fields = MessageToDict(storage, preserving_proto_field_name=True)
    identity, poses = fields.pop("identity", {}), fields.pop("pose", {})
    category = storage.WhichOneof("category")
    entry: dict[str, Any] = {"number": identity.get("no", ""), "id": identity.get("id", 0)}
    entry["type"] = category or _BASE
    dock, real = (_pose_numbers(poses.pop(key, None)) for key in ("dock", "real"))
    if dock:
        entry["pose"] = dock
    if real and real != dock:
        entry["real"] = real
    if identity.get("desc"):
        entry["description"] = identity["desc"]
    # what is left has no key of its own in an entry
    if category and not fields[category]:
        del fields[category]
    if poses:
        fields["pose"] = poses
    if fields:
        entry["details"] = fields
    return entry


class _Pose(NamedTuple):
    """A pose in the frame of the map, in m and rad."""

    x: float
    y: float
    theta: float


def _check_type(name: str) -> None:
    """Raise a ValueError if a mark cannot be of this type."""
    if name not in (_BASE, *_TYPES):
        raise ValueError(f"{name!r} is not one of {', '.join((_BASE, *_TYPES))}")


@dataclass(frozen=True)
class _MarkEntry:
    """A mark in a file of marks.

    Attributes:
        number: number of the mark, unique in the file.
        id: id of the mark, unique in the file; 0 for one above the highest id.
        type: type of the mark: `base`, or one of `_TYPES`.
        pose: pose of a robot that stands at the mark; None if only `real` is known.
        real: pose of the place itself; None if it is the same as `pose`.
        details: further fields of the robot's mark, as JSON; None if there are none.
        where: place of the entry in the file, for errors, e.g. `NAME: marks[3]`. It is set by
            `structure`, and is not a key of the entry.
    """

    number: str
    id: Annotated[int, Between(0, _MAX_ID)] = 0
    type: Annotated[str, _check_type] = _BASE
    pose: _Pose | None = None
    real: _Pose | None = None
    description: str = ""
    details: Any = None
    where: str = source_field()

    def __post_init__(self) -> None:
        if not self.pose and not self.real:
            raise ValueError("pose is missing")


@dataclass(frozen=True)
class _MarksFile:
    """The content of a file of marks.

    Attributes:
        marks: the storage places; `_storages` reads each edited one as a `_MarkEntry`.
        others: all other marks, as from `_other_marks`; None or empty to keep the robot's.
    """

    marks: Annotated[tuple[Any, ...], Between(0, _MAX_MARKS)]
    others: Any = None


def _storage(entry: _MarkEntry) -> Storage:
    """Return the mark that an entry of a file of marks describes.

    Raises:
        DataFileError: the details of the entry do not fit a mark of its type.
    """
    storage = Storage()
    if entry.details:
        _parse_into(f"{entry.where}.details", entry.details, storage)
    storage.identity.no = entry.number
    storage.identity.id = entry.id
    storage.identity.desc = entry.description
    given = storage.WhichOneof("category")
    if given and given != entry.type:
        text = f"details have the data of a {given}, but type is {entry.type}"
        raise DataFileError(f"{entry.where}: {text}")
    if entry.type != _BASE:
        getattr(storage, entry.type).SetInParent()  # sets the category, even without data
    for target, source in (
        (storage.pose.dock, entry.pose),
        (storage.pose.real, entry.real or entry.pose),
    ):
        if source:
            target.x, target.y, target.theta = source
            target.SetInParent()  # a pose of zeros is a pose, too
    return storage


def _other_marks(info: MarkInfo) -> dict[str, Any]:
    """Return all marks except the storage places, as JSON."""
    fields = MessageToDict(info, preserving_proto_field_name=True)
    return {key: value for key, value in fields.items() if key not in ("storages", "version")}


def _parse_into(where: str, value: Any, message: Any) -> None:
    """Add fields, as JSON, to a message; `where` is their place in the file, for errors.

    Raises:
        DataFileError: the message has no such fields.
    """
    try:
        ParseDict(value, message)
    except (ParseError, TypeError, ValueError, AttributeError) as error:
        text = f"does not fit {message.DESCRIPTOR.full_name}: {error}"
        raise DataFileError(f"{where}: {text}") from None


def _pose_numbers(pose: dict[str, float] | None) -> list[float] | None:
    return None if pose is None else [float(pose.get(key, 0.0)) for key in ("x", "y", "theta")]


_NAV2, _MARKS_FOLDER = "nav2", "marks"
"""Subfolders of a saved scene for the files that this program makes."""
_SCENE_MARKERS = (_MARKS_FOLDER, "scene.json")
"""A folder that contains one of these is a saved scene."""
_MARK_INFO = "mark_info.data"
"""Name of the robot's file with the marks of a map, in the folder of the map."""


def to_path(name: str) -> str:
    """Return the path of a robot's file in the folder of its scene; `unquote` is the inverse.

    If a part of the name is empty, `.` or `..`, the whole name becomes one file name.

    Raises:
        ToolError: a part of the name is too long for a file name, or the name is empty.
    """
    parts = name.split("/")
    if any(part in ("", ".", "..") for part in parts):
        return to_file_name(name)
    paths = [to_file_name(part) for part in parts]
    if paths[0] in (_NAV2, _MARKS_FOLDER):  # a folder of this program: encode its first letter
        paths[0] = f"%{ord(paths[0][0]):02X}{paths[0][1:]}"
    return "/".join(paths)


@dataclass(frozen=True)
class SavedScene:
    """A scene in a folder.

    Attributes:
        files: contents of the robot's files, by the robot's names. Those with marks contain the
            edits.
    """

    name: str
    files: dict[str, bytes]


def check_writable(target: Path, *, force: bool) -> None:
    """Check that a scene may be saved in a folder, with `force` also in place of a saved scene.

    Raises:
        ToolError: the path exists, and must not be replaced.
    """
    if not os.path.lexists(target):
        return
    if not force:
        raise ToolError(
            f"{target} exists already: use --force to replace it, or --output for another folder"
        )
    if target.is_symlink() or not (target / _MARKS_FOLDER).is_dir():
        raise ToolError(f"{target} is not a saved scene and is not replaced: move it first")


def write_scene(
    target: Path, data: SceneData, files: Mapping[str, bytes], *, force: bool
) -> list[str]:
    """Save a scene in a folder, atomically.

    Args:
        data: name of the scene, and its maps with their pictures and marks.
        files: contents of the robot's files, by the robot's names.
        force: True to replace a scene that was saved there before.

    Returns:
        Warnings: maps and masks that were not saved for nav2, because the robot sent no usable
        picture, and marks that were not saved for editing.

    Raises:
        ToolError: the scene cannot be saved.
    """
    contents = {to_path(name): content for name, content in files.items()}
    warnings: list[str] = []
    for area in data.maps:
        stem = to_file_name(area.name)
        images = [("map", area.map_png, stem)]
        if area.keepout_png:
            images.append(("the keep-out mask of map", area.keepout_png, f"{stem}_keepout"))
        for what, image, name in images:
            try:
                made = map_files(area, image, name)
            except MapError as error:  # the robot's own files are saved nevertheless
                warnings.append(f"{what} {area.name} is not saved for nav2: {error}")
                continue
            contents |= {f"{_NAV2}/{file}": content for file, content in made.items()}
        info = _marks_in(_mark_file(area.name, files), files)
        reports_marks = bool(area.mark_info.storages)
        lacks_marks = info is not None and reports_marks and not info.storages
        if info is None or lacks_marks:
            warnings.append(
                f"the marks of map {area.name} are not saved for editing: they are not in the "
                f"robot's file {_MARK_INFO}, or it has an unknown format"
            )
        else:
            contents[f"{_MARKS_FOLDER}/{stem}.yaml"] = marks_as_yaml(info, area.name)
    try:
        _write_folder(target, contents, force=force)
    except OSError as error:
        raise ToolError(f"scene {data.name} cannot be saved: {error}") from None
    return warnings


def read_scene(folder: Path) -> SavedScene:
    """Read a saved scene, whose name is that of the folder.

    Raises:
        ToolError: the folder is not a saved scene, or one of its files cannot be used.
    """
    if not _is_scene(folder):
        inside = ", ".join(str(each) for each in sorted(folder.glob("*")) if _is_scene(each))
        hint = f": give a folder in it: {inside}" if inside else ""
        raise ToolError(f"{folder} is not a saved scene{hint}")
    paths = {each.relative_to(folder).as_posix(): each for each in sorted(folder.rglob("*"))}
    files = {
        unquote(name): _read(path)
        for name, path in paths.items()
        if path.is_file() and not _is_own(name)
    }
    for path in sorted((folder / _MARKS_FOLDER).glob("*.yaml")):
        name = _mark_file(unquote(path.stem), files)
        old = _marks_in(name, files)
        if old is None:
            raise ToolError(f"remove {path}: there is no such map, or its marks cannot be read")
        if (new := read_marks(path, old)) is not old:
            files[name] = new.SerializeToString()
    return SavedScene(unquote(folder.resolve().name), files)


def _is_scene(folder: Path) -> bool:
    return any((folder / marker).exists() for marker in _SCENE_MARKERS)


def _is_own(path: str) -> bool:
    """Return True for a file that is not the robot's: of this program, or hidden at the top."""
    return path.startswith((f"{_NAV2}/", f"{_MARKS_FOLDER}/", "."))


def _mark_file(area: str, files: Iterable[str]) -> str:
    """Return the name of the robot's file with the marks of a map, also if it is missing.

    The name is empty if the robot has no folder of the map.
    """
    # the topmost folder of the map, because a deeper one may be a copy
    for name in sorted(files, key=lambda name: name.count("/")):
        before, folder, _ = f"/{name}".partition(f"/{area}/")
        if folder:
            return f"{before}{folder}{_MARK_INFO}".removeprefix("/")
    return ""


def _marks_in(name: str, files: Mapping[str, bytes]) -> MarkInfo | None:
    """Return the marks in a file of `files`; a missing file counts as empty.

    Return None without a name, or for an unknown format.
    """
    try:
        return MarkInfo.FromString(files.get(name, b"")) if name else None
    except DecodeError:  # other firmware may store marks in another format
        return None


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ToolError(f"{path} cannot be read: {error.strerror or error}") from None


def _move_hidden(source: Path, target: Path) -> None:
    """Move the hidden top-level entries of a folder, which need not exist, to another folder."""
    for path in source.glob(".*"):
        path.rename(target / path.name)


def _write_folder(target: Path, contents: Mapping[str, bytes], *, force: bool) -> None:
    """Write a folder under another name, then rename it, so that no incomplete folder is left."""
    target.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=".maps-", dir=target.parent))
    try:
        new, old = work / "new", work / "old"
        (new / _MARKS_FOLDER).mkdir(parents=True)
        for name, content in contents.items():
            path = new / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        check_writable(target, force=force)
        if target.exists():
            target.rename(old)
        try:
            _move_hidden(old, new)  # e.g. `.git`, which is not part of the scene
            new.rename(target)
        except OSError:
            if old.exists():
                _move_hidden(new, old)
                old.rename(target)
            raise
    finally:
        shutil.rmtree(work, ignore_errors=True)
