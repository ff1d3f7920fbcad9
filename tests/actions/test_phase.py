"""The phases of a goal, which the diagram in the docs must match."""

from __future__ import annotations

import re
from pathlib import Path

from woosh_robot_agent.ros.actions.goal import TRANSITIONS

PAGE = Path(__file__).parents[2] / "docs" / "architecture.md"
EDGE = re.compile(r"^ +(\[\*\]|\w+) --> (\[\*\]|\w+)(?:: (.+))?$")


def test_diagram_shows_the_transitions_and_the_first_and_last_phase() -> None:
    found = re.search(r"```mermaid\nstateDiagram-v2\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert found
    lines = [EDGE.match(line) for line in found[1].splitlines()]
    assert all(lines)
    edges = [(line[1], line[2], line[3] or "") for line in lines if line]
    inner = {(before.name, after.name, step.value) for (before, step), after in TRANSITIONS.items()}
    assert sorted(edges) == sorted([("[*]", "NEW", ""), *inner, ("ENDED", "[*]", "")])
