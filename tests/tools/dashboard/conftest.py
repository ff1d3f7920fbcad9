"""Fixtures of the tests of the dashboard."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.tools.dashboard.browsers import SharedBrowser


@pytest.fixture(scope="session")
def shared_browser() -> Iterator[SharedBrowser]:
    """The browser of all tests of this process, because each start takes seconds."""
    running = SharedBrowser()
    yield running
    running.close()
