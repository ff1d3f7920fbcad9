"""Write a recording to one or several MCAP files."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link.reports import LogOnce, RecentDict
from woosh_robot_agent.pb.robot.robot_pb2 import General, PoseSpeed, RobotInfo, ScannerData
from woosh_robot_agent.tools.recording import layout
from woosh_robot_agent.tools.recording.files import Limits, McapFile, RecordingFiles
from woosh_robot_agent.tools.recording.views import (
    MapFinder,
    PreparedMap,
    View,
    decode_message,
    prepare_map,
    views_of,
)

_LOG = logging.getLogger(__name__)
_THINNED = (PoseSpeed, ScannerData)
"""Types whose views are limited in rate, because an eye cannot follow them at the highest rates.

They contain no maps or metadata, so `_add_waiting_views` has only views to write.
"""
_VIEW_PERIOD = 20_000_000
"""Minimum time between two views of a type in `_THINNED`, in ns."""
_MAX_MAPS = 100
"""Maximum number of maps that are repeated in each file, and of maps that wait to be prepared."""


class RecordingWriter:
    """Writes a recording: frames, connection events, decoded messages, and views.

    A view is a message for display in Foxglove. A crash loses at most what was written since
    `RecordingFiles.flush` last wrote to the file. A file error ends the recording but is not
    raised, because `RecordingProxy` must keep forwarding.

    Args:
        path: path of the new file, which must not exist; see `RecordingFiles` for a split
            recording.
        address: address of the chassis, for the metadata.
        on_early_end: called once with the reason if the recording ends before `close`, or if
            `close` fails.

    Attributes:
        files: the files; open until `close`.
        connections: number of connections between a client and the chassis so far.
        answered: True once the chassis has sent a frame.
        refusal: why the chassis could not be reached, for the last event of kind `refused`; empty
            if there was none.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(
        self, path: Path, address: str, limits: Limits, on_early_end: Callable[[str], None]
    ) -> None:
        self.connections = 0
        self.answered = False
        self.refusal = ""
        self._seen = 0
        """Number of frames passed to `add_frame`."""
        self._log = LogOnce(_LOG)
        self._finder = MapFinder()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="maps")
        self._shown_at: dict[type[Message], int] = dict.fromkeys(_THINNED, 0)
        """Time of the last view of each type in `_THINNED`, in ns; 0 before the first."""
        self._waiting: dict[type[Message], Message] = {}
        """The newest message of each type in `_THINNED`, as long as its view is delayed."""
        self._preparing: deque[Future[PreparedMap | None]] = deque()
        """Maps that are prepared in the thread `_worker`; the result of an unusable one is None."""
        self._maps: RecentDict[str, PreparedMap] = RecentDict(_MAX_MAPS)
        """The last map with each name; each new file begins with all of them."""
        self._states: dict[str, View] = {}
        """Views that are still valid, by their key `View.state`; each new file begins with them."""
        self._robot: dict[str, str] = {}
        """The robot's number, model and software, as metadata; empty if unknown."""
        self._start = time.time_ns()
        self._clock_offset = self._start - time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        """Unix time at zero of CLOCK_BOOTTIME, in ns."""
        self._metadata = {
            "version": layout.VERSION,
            "address": address,
            "started": str(self._start),
        }
        self._file_count = 0
        # the last attribute, because it calls `_begin_file`, which uses the others
        self.files = RecordingFiles(path, limits, self._begin_file, on_early_end)

    @property
    def frames(self) -> int:
        """Number of frames in the files; complete after `close`."""
        return self.files.count(layout.FRAMES.topic)

    @property
    def lost(self) -> int:
        """Number of frames that are not in the files; exact after `close`."""
        return self._seen - self.frames

    def now(self) -> int:
        """Return the Unix time in ns, by a monotonic clock that also runs during a suspension."""
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME) + self._clock_offset

    def add_frame(
        self,
        connection: int,
        sender: layout.Side,
        data: bytes,
        *,
        text: bool,
        received: int | None = None,
    ) -> None:
        """Write a frame.

        Args:
            sender: side that sent the frame: the client or the chassis.
            data: payload of the frame.
            text: True for a text frame, whose payload should be UTF-8.
            received: time at which the frame passed, by `now`; None if it has just passed.
        """
        self._seen += 1
        self.answered |= sender == "chassis"
        if not self.files.is_open:
            return
        frame: str | bytes | None = data  # None for a text frame that is not UTF-8
        message = layout.FrameMessage(connection=connection, sender=sender)
        if not text:
            message.binary = data
        else:
            try:
                message.text = frame = data.decode()
            except UnicodeDecodeError:
                message.invalid_text, frame = data, None
        now = self.now() if received is None else received
        decoded = None
        if frame is not None:
            decoded = self._guard("decode", decode_message, sender, frame)
        sent = None if decoded is None else decoded.sent
        is_open = self.files.add(layout.FRAMES, now, message.SerializeToString(), sent)
        if is_open and decoded is not None:
            self.files.add(decoded.channel, now, decoded.message.SerializeToString(), sent)
            if sender == "chassis":
                self._guard("view", self._add_views, decoded.message, now)

    def add_event(
        self,
        connection: int,
        kind: layout.EventKind,
        by: layout.Side,
        text: str = "",
        at: int | None = None,
    ) -> None:
        """Write an event.

        Args:
            text: details, e.g. why the chassis could not be reached; may be empty.
            at: time of the event, by `now`; None if it has just happened.
        """
        self.connections += kind == "open"
        if kind == "refused":
            self.refusal = text
        message = layout.EventMessage(connection=connection, kind=kind, by=by, text=text)
        self.files.add(layout.EVENTS, self.now() if at is None else at, message.SerializeToString())

    def flush(self) -> None:
        """Pass everything written so far on to the operating system."""
        self._add_waiting_views()
        self._add_maps()
        self.files.flush()

    def close(self) -> None:
        """Wait for the maps that are being prepared, and complete and close the current file."""
        self._worker.shutdown()
        self._add_waiting_views()
        self._add_maps()
        self.files.close()

    def discard(self) -> None:
        """Close and delete all files."""
        self.close()
        for path in self.files.paths:
            path.unlink()

    def _guard(self, what: str, work: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of `work`; if it raises an error, log that and return None.

        A bug must not cut the connection. `what` is the verb for the log: "cannot `what` a frame".
        """
        try:
            return work(*arguments)
        except Exception as error:
            self._log.warn(what, f"cannot {what} a frame, which is recorded as it is: {error!r}")
            return None

    def _add_views(self, message: Message, now: int) -> None:
        """Write the views, maps and metadata of a message of the chassis, or delay its views.

        Maps are written by `_add_maps` once they are prepared. `now` is the Unix time in ns.
        """
        cls = type(message)
        if cls in _THINNED:
            if now - self._shown_at[cls] < _VIEW_PERIOD:
                self._waiting[cls] = message
                return
            self._shown_at[cls] = now
            self._waiting.pop(cls, None)
        self._add_views_of(message, now)
        for found in self._finder.maps_in(message):
            if len(self._preparing) >= _MAX_MAPS:
                self._log.warn("maps", f"map {found.area.name} is left out: too many at a time")
            else:
                self._preparing.append(self._worker.submit(prepare_map, found, now))
        if isinstance(message, RobotInfo) and message.HasField("genral"):
            message = message.genral  # spelled so in the robot's messages
        if isinstance(message, General):
            self._set_robot(message)

    def _add_views_of(self, message: Message, now: int) -> None:
        """Write the views of a message, and remember those that stay valid."""
        for view in views_of(message, now):
            if view.state:
                self._states[view.state] = view
            self._add_view(view, now)

    def _add_view(self, view: View, now: int) -> None:
        self.files.add(view.channel, now, view.message.SerializeToString())

    def _add_waiting_views(self) -> None:
        """Write the views that `_add_views` has delayed."""
        now = self.now()
        waiting, self._waiting = self._waiting, {}
        for cls, message in waiting.items():
            self._shown_at[cls] = now
            self._guard("view", self._add_views_of, message, now)

    def _add_maps(self) -> None:
        """Write the maps that have been prepared; attach their files only if these have changed."""
        while self._preparing and self._preparing[0].done():
            future = self._preparing.popleft()
            prepared: PreparedMap | None = self._guard("view", future.result)
            if prepared is None:
                continue
            known = self._maps.get(prepared.name)
            now = self.now()
            if known is None or known.files != prepared.files:
                for attachment in prepared.attachments():
                    self.files.attach(*attachment, now)
            self._maps[prepared.name] = prepared
            if prepared.view is not None:
                self._add_view(prepared.view, now)

    def _set_robot(self, general: General) -> None:
        """Write the robot's number, model and software, if they have changed."""
        robot = {
            "serial_number": str(general.serial_number),
            "model": general.display_model or general.urdf_name,
            "software": general.version.rc,
            "system": general.version.system,
        }
        if robot != self._robot:
            self._robot = robot
            self.files.add_metadata(layout.ROBOT_METADATA, robot)

    def _begin_file(self, file: McapFile) -> None:
        """Write metadata, maps and the views that are still valid to the start of a new file."""
        file.add_metadata(layout.METADATA, self._metadata | {"part": str(self._file_count)})
        self._file_count += 1
        if self._robot:
            file.add_metadata(layout.ROBOT_METADATA, self._robot)
        now = self.now()
        views = list(self._states.values())
        for prepared in self._maps.values():
            for attachment in prepared.attachments():
                file.attach(*attachment, now)
            if prepared.view is not None:
                views.append(prepared.view)
        for view in views:
            file.add(view.channel, now, now, view.message.SerializeToString())
