"""Generated files and tables are up to date."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from woosh_robot_agent import generate
from woosh_robot_agent.endpoints import minimum_timeouts

ROOT = Path(__file__).parent.parent


def test_generated_files_are_up_to_date() -> None:
    stale = [str(path.relative_to(ROOT)) for path, _ in generate.outdated(ROOT)]
    assert not stale, f"out of date: {', '.join(stale)}; run {generate.COMMAND}"


def test_each_table_has_a_place() -> None:
    text = "\n".join(page.read_text() for page in generate.pages(ROOT))
    assert set(re.findall(r"^<!-- generated: (\S+) -->$", text, re.M)) == set(generate.TABLES)


def test_each_minimum_timeout_has_a_row() -> None:
    rows = "\n".join(page.read_text() for page in generate.pages(ROOT)).splitlines()
    for request, timeout in minimum_timeouts().items():
        end = f"| {request} | {timeout:g} s |"
        assert any(row.startswith("| ") and row.endswith(end) for row in rows), request


def test_a_changed_table_is_rewritten() -> None:
    page = "# Page\n\n<!-- generated: endpoints -->\n| old |\n<!-- end -->\n\nText\n"
    table = generate.TABLES["endpoints"]()
    new = f"# Page\n\n<!-- generated: endpoints -->\n{table}\n<!-- end -->\n\nText\n"
    assert generate.with_tables(page) == new
    assert generate.with_tables(new) == new


def test_an_unknown_table_is_refused() -> None:
    page = "<!-- generated: nothing -->\n<!-- end -->\n"
    with pytest.raises(ValueError, match="unknown table 'nothing'"):
        generate.with_tables(page)
