"""A progress bar on stderr, if that is a terminal."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)

from woosh_robot_agent.link import ChassisClient

_PERIOD = 0.1
"""Time between two updates, in seconds."""


@asynccontextmanager
async def receiving(chassis: ChassisClient, text: str) -> AsyncIterator[None]:
    """Show how many bytes arrive meanwhile. The total is not known in advance."""
    start, _ = chassis.traffic()
    with _progress() as progress:
        task = progress.add_task(escape(text), total=None)
        async with _repeatedly(
            lambda: progress.update(task, completed=max(0, chassis.traffic()[0] - start))
        ):
            yield


@asynccontextmanager
async def sending(chassis: ChassisClient, text: str, size: int) -> AsyncIterator[None]:
    """Show how many of `size` bytes are sent meanwhile.

    The frame is larger than the files in it, so the bar shows the share of the frame.
    """
    largest = 0
    with _progress() as progress:
        task = progress.add_task(escape(text), total=size)

        def update() -> None:
            nonlocal largest
            waiting = chassis.traffic()[1]
            largest = max(largest, waiting)
            if largest:
                progress.update(task, completed=size * (1 - waiting / largest))

        async with _repeatedly(update):
            yield


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )


@asynccontextmanager
async def _repeatedly(update: Callable[[], None]) -> AsyncIterator[None]:
    async def run() -> None:
        while True:
            update()
            await asyncio.sleep(_PERIOD)

    task = asyncio.create_task(run())
    try:
        yield
    finally:
        task.cancel()
