"""The layers in docs/architecture.md are those of the contracts in pyproject.toml."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]


def contracts() -> list[dict[str, Any]]:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    found: list[dict[str, Any]] = settings["tool"]["importlinter"]["contracts"]
    return found


def documented_layers() -> list[set[str]]:
    """The modules in each row of the table of layers, from top to bottom."""
    text = (ROOT / "docs/architecture.md").read_text()
    table = text.partition("## Layers")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    return [set(re.findall(r"`(\w+)/?`", row)) for row in rows]


def test_the_page_lists_the_layers_of_the_contract() -> None:
    (layers,) = (each["layers"] for each in contracts() if each.get("id") == "layers")
    assert documented_layers() == [set(re.findall(r"\w+", layer)) for layer in layers]


def test_no_contract_ignores_an_import() -> None:
    assert not [each["name"] for each in contracts() if each.get("ignore_imports")]
