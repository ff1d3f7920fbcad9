"""The interface packages as the facts describe them, and interface files in the same form."""

from __future__ import annotations

import json
from typing import Any

from tests.fact_files import FOLDER, facts

FACTS = FOLDER / "ros"
HASHES: dict[str, str] = json.loads((FACTS / "type_hashes.json").read_text())
PACKAGES = {path.stem: facts(f"ros/{path.name}") for path in FACTS.glob("*.yaml")}
KINDS = {
    "messages": ("msg", [""]),
    "services": ("srv", ["request", "response"]),
    "actions": ("action", ["goal", "result", "feedback"]),
}


def facts_of(package: str) -> dict[str, list[dict[str, Any]]]:
    """Return constants and fields of each part of a type in the facts, by name (`msg/Mode`)."""
    return {
        f"{folder}/{short}": [facts[part] if part else facts for part in parts]
        for kind, (folder, parts) in KINDS.items()
        for short, facts in PACKAGES[package][kind].items()
    }


def parts_of(text: str) -> list[dict[str, list[str]]]:
    """Return constants and fields of each part of a .msg, .srv or .action file."""
    parts: list[dict[str, list[str]]] = [{"constants": [], "fields": []}]
    for line in text.splitlines():
        definition = line.partition("#")[0].strip()
        if definition == "---":
            parts.append({"constants": [], "fields": []})
        elif definition:
            parts[-1]["constants" if "=" in definition else "fields"].append(definition)
    return parts
