"""Data that the page shows, in named parts that are sent to the viewers."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Collection
from typing import Any

SCAN = "scan"
"""Name of the part that holds the laser scan, which is binary; the others are JSON."""


class Parts:
    """The parts of one robot, or the parts about all robots, and their viewers.

    A part is one named section of the page's data, e.g. the laser scan. A viewer is a page in a
    browser. A part is sent to the viewers when its data has changed.

    Attributes:
        messages: last message of each part, by name: JSON as text, or binary.
        watched: set while there are viewers.
    """

    def __init__(self) -> None:
        self.messages: dict[str, str | bytes] = {}
        self._sources: dict[str, Callable[[], Any]] = {}
        """Functions that return the data of the parts, by name."""
        self._data: dict[str, Any] = {}
        """Data of the last message of each part, by name."""
        self._on_change: list[str] = []
        """Names of the parts that were added with `on_change`."""
        self._each_second: list[str] = []
        """Names of the parts that were added with `each_second`."""
        self._viewers: dict[object, Callable[[Collection[str]], None]] = {}
        """Callbacks of the viewers."""
        self._changed = asyncio.Event()
        """Set by `changed`, until the parts are published."""
        self.watched = asyncio.Event()

    def add(
        self,
        name: str,
        source: Callable[[], Any],
        *,
        on_change: bool = True,
        each_second: bool = False,
    ) -> None:
        """Register a part and the function that returns its data.

        Args:
            source: returns the data of the part, which must not change afterwards.
            on_change: rebuild the part after each call of `changed`.
            each_second: rebuild the part every second, for data that changes without a call of
                `changed`.
        """
        self._sources[name] = source
        if on_change:
            self._on_change.append(name)
        if each_second:
            self._each_second.append(name)

    def changed(self) -> None:
        """Note that the data of parts may have changed."""
        self._changed.set()

    def put(self, name: str, message: bytes) -> None:
        """Set the message of a binary part, and tell the viewers if it has changed."""
        if self.messages.get(name) != message:
            self.messages[name] = message
            self._tell({name})

    def publish(self, *names: str) -> None:
        """Rebuild the messages of parts, and tell the viewers which of them have changed."""
        changed = set()
        for name in names:
            data = self._sources[name]()
            # Encoding a large map takes long, comparing does not: its lists are the same objects.
            if name not in self.messages or self._data[name] != data:
                content = {"part": name, "data": data}
                self.messages[name] = json.dumps(content, separators=(",", ":"))
                self._data[name] = data
                changed.add(name)
        self._tell(changed)

    async def publish_changes(self, period: float) -> None:
        """Publish the parts with `on_change` after calls of `changed`, while there are viewers.

        Args:
            period: minimum time between two publications, in seconds.
        """
        while True:
            await self.watched.wait()
            await self._changed.wait()
            self._changed.clear()
            self.publish(*self._on_change)
            await asyncio.sleep(period)

    async def publish_each_second(self) -> None:
        """Publish the parts with `each_second`, while there are viewers."""
        while True:
            await self.watched.wait()
            self.publish(*self._each_second)
            await asyncio.sleep(1.0)

    def watch(self, viewer: object, callback: Callable[[Collection[str]], None]) -> None:
        """Call `callback` with the names of parts that have changed, until `unwatch(viewer)`.

        The first call comes at once, with all parts that have a message, in the order in which they
        were published first. The scan is not among them, because the last scan may be old.
        """
        self._viewers[viewer] = callback
        self.watched.set()
        self.changed()
        callback([name for name in self.messages if name != SCAN])

    def unwatch(self, viewer: object) -> None:
        """Call the callback of a viewer no more; idempotent.

        Without any viewer, nothing is published each second.
        """
        self._viewers.pop(viewer, None)
        if not self._viewers:
            self.watched.clear()

    def _tell(self, names: Collection[str]) -> None:
        if names:
            for callback in list(self._viewers.values()):
                callback(names)
