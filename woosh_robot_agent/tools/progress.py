"""A progress bar on stderr."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn

_PERIOD = 0.1
"""Time between two updates of the bar, in seconds."""


@contextmanager
def progress_bar(
    text: str, total: float | None, update: Callable[[], dict[str, Any]], *columns: ProgressColumn
) -> Iterator[None]:
    """Show a bar while the block runs, if stderr is a terminal. Needs a running event loop.

    Args:
        text: text before the bar.
        total: the work to do; None if it is not known.
        update: returns the changed arguments of `rich.progress.Progress.update`, e.g. `completed`,
            the work done so far.
        columns: columns after the bar.
    """
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        *columns,
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    task = bar.add_task(text, total=total)

    async def refresh() -> None:
        while True:
            bar.update(task, **update())
            await asyncio.sleep(_PERIOD)

    with bar:
        refreshing = asyncio.ensure_future(refresh())
        try:
            yield
        finally:
            refreshing.cancel()
