"""The phases of a goal, which the diagram in the docs must match."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from woosh_robot_agent.ros.actions.goal import TRANSITIONS

PAGE = Path(__file__).parents[2] / "docs" / "architecture.md"
EDGE = re.compile(r"^ +(\[\*\]|\w+) --> (\[\*\]|\w+)(?:: (.+))?$")


@pytest.fixture(scope="module")
def edges() -> list[tuple[str, str, str]]:
    """Source, target and label of each arrow in the diagram."""
    found = re.search(r"```mermaid\nstateDiagram-v2\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert found
    lines = [EDGE.match(line) for line in found[1].splitlines()]
    assert all(lines)
    return [(line[1], line[2], line[3] or "") for line in lines if line]


def test_diagram_shows_the_transitions(edges: list[tuple[str, str, str]]) -> None:
    inner = [edge for edge in edges if "[*]" not in edge]
    assert len(inner) == len(set(inner))
    assert set(inner) == {
        (before.name, after.name, step.value) for (before, step), after in TRANSITIONS.items()
    }


def test_diagram_shows_the_first_and_the_last_phase(edges: list[tuple[str, str, str]]) -> None:
    outer = [edge for edge in edges if "[*]" in edge]
    assert outer == [("[*]", "NEW", ""), ("ENDED", "[*]", "")]
