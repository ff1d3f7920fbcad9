"""The state file, which keeps the order and the header ids of a vehicle over a restart."""

from __future__ import annotations

import asyncio
import fcntl
import json
import logging
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote

from woosh_robot_agent.data_files import structure
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.motion.wheel_owner import ACTIONS
from woosh_robot_agent.sentences import THEN, Sentence, said_by
from woosh_robot_agent.vda5050.messages.state import ActionState, ErrorType, VehicleError, warning
from woosh_robot_agent.vda5050.orders.machine import OrderMemory

_NOT_SAVED = Sentence("the order does not survive a restart of the connector: {error}")
_REMOVE = Sentence("remove {path}, which is out of date, before a restart")
_TOO_LARGE = Sentence("it has more than {most} bytes")
_OTHER_FORMAT = Sentence("its format is {found}, not {own}")
_NO_ACTION = Sentence("the robot has no {what}")
_INVALID_ORDER = Sentence("the parts of its order do not fit together")
_DAMAGED = Sentence("the last order is unknown, because {path} was damaged ({error})")

_LOG = logging.getLogger(__name__)
_FORMAT = 1
"""Version of the file format."""
_MAX_SIZE = 16 * 2**20
"""Maximum size of a file that is read, in bytes."""
_SAVE_WITHIN = 2.0
"""Maximum delay before the progress of the order and of instant actions is saved, in seconds."""
_MAX_NAME = 200
"""Maximum length of a file's name without its suffix, in characters."""


@dataclass(frozen=True)
class Record:
    """Content of the state file.

    Attributes:
        robot_id: id that the robot reports.
        serial_number: serial number that the robot reports.
        task_id: id of the robot's task that drives the current leg (part of an order without a
            stop); 0 without such a task.
        action_task_id: id of the robot's task that an action waits for; 0 without one.
        calls: full names of the commands of the robot's own actions that it executes.
        known_ids: ids of the last instant actions.
        last_motion: id of the last instant action that moves something; empty if there was none
            since the start of the program. It is not used after a restart. A change of it makes
            `Store.save` write at once, so that `known_ids` contains the action before it begins.
        speed_is_limited: True if the robot may have a speed limit of the connector.
        header_ids: next header id of each topic.
        format: number of the format of the file.
    """

    robot_id: int = 0
    serial_number: int = 0
    task_id: int = 0
    action_task_id: int = 0
    calls: tuple[str, ...] = ()
    order: OrderMemory = field(default_factory=OrderMemory)
    instant_actions: tuple[ActionState, ...] = ()
    known_ids: tuple[str, ...] = ()
    last_motion: str = ""
    speed_is_limited: bool = False
    header_ids: Mapping[str, int] = field(default_factory=dict)
    format: int = _FORMAT


class StoreInUseError(Exception):
    """Another process uses the state file."""


def state_folder() -> Path:
    """Return the default folder of state files, in the XDG state folder of the user."""
    base = os.environ.get("XDG_STATE_HOME", "")
    folder = Path(base) if os.path.isabs(base) else Path.home() / ".local" / "state"
    return folder / "woosh_robot_agent" / "vda5050"


class Store:
    """State file of one vehicle, which is replaced as a whole.

    The last saved record survives a crash at any moment, and a loss of power.

    Args:
        folder: folder of the file, which is created; None for no file.
        name: name of the vehicle, unique in the folder.

    Attributes:
        error: why the last record was not saved; None if it was saved.
    """

    def __init__(self, folder: Path | None, name: str) -> None:
        self._path = None if folder is None else folder / f"{quote(name, safe='')[:_MAX_NAME]}.json"
        self._lock: IO[bytes] | None = None
        """The lock file, which is locked while it is open; None before `open`."""
        self._record = Record()
        """The record in the file: the one that was read, or saved last."""
        self._next = self._record
        """The record to save next."""
        self._timer: asyncio.TimerHandle | None = None
        """Saves `_next` later; None if nothing waits to be saved."""
        self._log = LogOnce(_LOG)
        self.error: VehicleError | None = None

    def open(self) -> tuple[Record, VehicleError | None]:
        """Lock the file for this process, and read it.

        A damaged file is renamed.

        Returns:
            The record, and an error if the file was damaged. Without a usable file, the record is
            empty.

        Raises:
            StoreInUseError: another process uses the file.
            OSError: the folder or the file cannot be used.
        """
        if self._path is None:
            return self._record, None
        self._path.parent.mkdir(parents=True, exist_ok=True)
        lock = self._path.with_suffix(".lock").open("ab")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise StoreInUseError(
                f"another connector uses {self._path}, or another robot has this serial number; "
                "each robot needs one connector and a serial number of its own"
            ) from None
        self._lock = lock
        try:
            return self._load(self._path)
        except OSError:
            self.close()
            raise

    def save(self, record: Record) -> None:
        """Save a record, but keep the saved header ids.

        Data that prevent a second execution, e.g. the id of an order, are on the disk on return. A
        record that differs only in the progress of the order and of the instant actions is saved
        within `_SAVE_WITHIN`: writing a file takes milliseconds, in which nothing else happens.

        If saving fails, the file is removed, because an old record could make the vehicle repeat
        what it has done.
        """
        self._next = record
        if not self._can_wait(record):
            self._save_next()
        elif self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(_SAVE_WITHIN, self._save_next)

    def save_header_ids(self, header_ids: Mapping[str, int]) -> None:
        """Save the header id of each topic with which to continue after a restart."""
        self._save(replace(self._record, header_ids=dict(header_ids)))

    def close(self) -> None:
        """Save a record that waits to be saved, and unlock the file for other processes."""
        if self._timer is not None:
            self._save_next()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _save_next(self) -> None:
        """Save the record that waits, with the saved header ids."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._save(replace(self._next, header_ids=self._record.header_ids))

    def _can_wait(self, record: Record) -> bool:
        """Return True if the file has all of a record except the latest progress.

        Progress is which nodes and edges are left, where the vehicle stands, and the states and ids
        of instant actions. If the latest progress is lost, nothing that moves is repeated.
        """
        saved = self._record
        order_with_saved_progress = replace(
            record.order,
            last_node=saved.order.last_node,
            nodes=saved.order.nodes,
            edges=saved.order.edges,
            on_edge=saved.order.on_edge,
            place=saved.order.place,
            leg_length=saved.order.leg_length,
        )
        with_saved_progress = replace(
            record,
            order=order_with_saved_progress,
            instant_actions=saved.instant_actions,
            known_ids=saved.known_ids,
            header_ids=saved.header_ids,
        )
        return self.error is None and with_saved_progress == saved

    def _save(self, record: Record) -> None:
        """Write a record, unless the file has it already."""
        if record == self._record and self.error is None:
            return
        self._record = record
        if self._path is None or self._lock is None:
            return
        try:
            replace_file(self._path, to_json(record))
        except OSError as error:
            self._report_failure(self._path, error)
        else:
            self.error = None
            self._log.clear()

    def _report_failure(self, path: Path, error: OSError) -> None:
        """Remove the file, which is out of date, and report why a record was not saved."""
        reason: str = _NOT_SAVED(error=str(error))
        try:
            path.unlink(missing_ok=True)
        except OSError:
            reason = THEN(one=reason, other=_REMOVE(path=str(path)))
        self._log.warn("save", reason)
        self.error = warning(ErrorType.STATE_FILE, reason, "make space, or correct the permissions")

    def _load(self, path: Path) -> tuple[Record, VehicleError | None]:
        """Read the file, and rename a damaged one.

        Returns:
            The record, which is empty without a usable file, and an error if the file was damaged.
        """
        try:
            self._record = self._read(path)
        except FileNotFoundError:
            pass
        except (ValueError, RecursionError) as error:
            return self._record, self._put_aside(path, error)
        return self._record, None

    def _read(self, path: Path) -> Record:
        """Return the record in the file.

        Raises:
            FileNotFoundError: there is no file.
            OSError: the file cannot be read.
            ValueError, RecursionError: the file is damaged, or has another format.
        """
        with path.open("rb") as file:
            data = file.read(_MAX_SIZE + 1)
        if len(data) > _MAX_SIZE:
            raise ValueError(_TOO_LARGE(most=_MAX_SIZE))
        record = structure(Record, json.loads(data), "record", known_only=False, own=True)
        if record.format != _FORMAT:
            raise ValueError(_OTHER_FORMAT(found=record.format, own=_FORMAT))
        for name in record.calls:
            if name not in ACTIONS:  # e.g. of a newer version of the connector
                raise ValueError(_NO_ACTION(what=name))
        order = record.order
        # each node still to be reached has one edge that leads to it, and each leg has a task
        fits = len(order.nodes) == len(order.edges) >= order.leg_length >= 0
        if not fits or (order.leg_length and not record.task_id):
            raise ValueError(_INVALID_ORDER())
        return record

    def _put_aside(self, path: Path, error: Exception) -> VehicleError:
        """Rename a damaged file, and return the error that reports it."""
        aside = path.with_suffix(".damaged")
        path.replace(aside)
        reason = _DAMAGED(path=str(path), error=said_by(error))
        _LOG.error("%s; it was renamed to %s", reason, aside)
        return warning(
            ErrorType.STATE_FILE, reason, "check where the robot stands, and send a new order"
        )


def to_json(value: Any) -> bytes:
    """Return an instance of a dataclass as JSON, with enumeration members as their values."""
    plain = asdict(value)
    return json.dumps(plain, default=lambda each: each.value, separators=(",", ":")).encode()


def replace_file(path: Path, content: bytes) -> None:
    """Write a file atomically: at any moment it has either its old or its new content."""
    new = path.with_suffix(".new")
    with new.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)
    # without this, a loss of power may undo the renaming
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
