"""Fixtures of the tests of the dashboard."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.tools.dashboard.browsers import (
    SharedBrowser,
    SimulatedPage,
    check_console_and_requests,
    open_page,
)


@pytest.fixture(scope="session")
def shared_browser() -> Iterator[SharedBrowser]:
    """The browser of all tests of this process, because each start takes seconds."""
    running = SharedBrowser()
    yield running
    running.close()


@pytest.fixture
def robot() -> Iterator[SimulatedPage]:
    """A simulated robot with its page."""
    running = SimulatedPage()
    yield running
    running.close()


@pytest.fixture
def browser(robot: SimulatedPage, shared_browser: SharedBrowser) -> Iterator[Any]:
    """A browser that shows the page; at the end, its console and its requests are checked."""
    with shared_browser.window() as driver:
        open_page(driver, robot.url)
        yield driver
        check_console_and_requests(driver, robot.url)
