"""Stores of what viewers see: the newest message of each part."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Set
from typing import Any

SCAN = "scan"
"""Name of the part that holds the laser scan, which is binary; the others are JSON."""


class Parts:
    """What viewers see of a robot, or of all of them: a message for each part.

    It is sent again when it changes.

    Attributes:
        messages: last message of each part, by its name: JSON as text, or binary.
    """

    def __init__(self) -> None:
        self.messages: dict[str, str | bytes] = {}
        self._sources: dict[str, Callable[[], Any]] = {}
        """Functions that return the data of the parts, by name."""
        self._on_change: list[str] = []
        self._each_second: list[str] = []
        self._viewers: dict[object, Callable[[Set[str]], None]] = {}
        """Callbacks of the viewers."""
        self._changed = asyncio.Event()
        self._watched = asyncio.Event()
        """Set while somebody watches."""

    def add(
        self,
        name: str,
        source: Callable[[], Any],
        *,
        on_change: bool = True,
        each_second: bool = False,
    ) -> None:
        """Add a part.

        Args:
            name: name of the part.
            source: returns the data of the part.
            on_change: make it anew soon after each call of `changed`.
            each_second: make it anew once a second, because it changes without such a call.
        """
        self._sources[name] = source
        if on_change:
            self._on_change.append(name)
        if each_second:
            self._each_second.append(name)

    def changed(self) -> None:
        """Tell that the data of parts may have changed."""
        self._changed.set()

    def put(self, name: str, message: bytes) -> None:
        """Set the message of a binary part."""
        if self.messages.get(name) != message:
            self.messages[name] = message
            self._tell({name})

    def publish(self, *names: str) -> None:
        """Make the messages of parts, and tell the viewers which ones have changed."""
        changed = set()
        for name in names:
            content = {"part": name, "data": self._sources[name]()}
            message = json.dumps(content, separators=(",", ":"))
            if self.messages.get(name) != message:
                self.messages[name] = message
                changed.add(name)
        self._tell(changed)

    async def publish_changes(self, period: float) -> None:
        """Publish parts whenever they may have changed, while somebody watches.

        Args:
            period: shortest time between two times, in seconds.
        """
        while True:
            await self._watched.wait()
            await self._changed.wait()
            self._changed.clear()
            self.publish(*self._on_change)
            await asyncio.sleep(period)

    async def publish_each_second(self) -> None:
        """Publish the parts that change without a call of `changed`, while somebody watches."""
        while True:
            await self._watched.wait()
            self.publish(*self._each_second)
            await asyncio.sleep(1.0)

    def watch(self, viewer: object, callback: Callable[[Set[str]], None]) -> None:
        """Call `callback` with the names of parts that have changed, at first with all of them."""
        self._viewers[viewer] = callback
        self._watched.set()
        self.changed()
        callback(self.messages.keys() - {SCAN})

    def unwatch(self, viewer: object) -> None:
        """End what `watch` began; idempotent."""
        self._viewers.pop(viewer, None)
        if not self._viewers:
            self._watched.clear()

    @property
    def watched(self) -> bool:
        """True while somebody watches."""
        return self._watched.is_set()

    async def wait_watched(self) -> None:
        """Wait until somebody watches."""
        await self._watched.wait()

    def _tell(self, names: Set[str]) -> None:
        if names:
            for callback in list(self._viewers.values()):
                callback(names)
