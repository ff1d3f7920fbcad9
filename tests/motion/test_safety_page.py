"""Each rule in docs/safety.md names a test that exists."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text()


@cache
def names_in(file: Path) -> set[str]:
    """Return the names of the tests in a file as in pytest's ids: `name` or `Class::name`."""
    found = set()
    for node in ast.parse(file.read_text()).body:
        members = node.body if isinstance(node, ast.ClassDef) else [node]
        prefix = f"{node.name}::" if isinstance(node, ast.ClassDef) else ""
        for member in members:
            if isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef):
                found.add(prefix + member.name)
    return found


def test_each_named_test_exists() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::([\w:]+)`", PAGE)
    assert len(named) > 20
    for path, name in named:
        assert name.startswith("test_") or "::test_" in name
        assert name in names_in(ROOT / path), f"{path}::{name}"


def test_each_rule_names_a_test() -> None:
    rules = re.findall(r"^- \*\*\d+\.\d+\*\* .*\n(?:  .*\n)+", PAGE, re.M)
    assert len(rules) == len(re.findall(r"^- ", PAGE, re.M)) > 10
    assert not [rule for rule in rules if "tests/" not in rule]
