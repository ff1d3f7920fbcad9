"""The parts of the documentation that benchmarks write."""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks.processes import ROOT

DOCS = ROOT / "docs"
SPEED_PAGE = DOCS / "speed.md"
SIMULATOR_PAGE = DOCS / "simulator.md"


def write_part(part: str, text: str, page: Path | None = None) -> None:
    """Replace the text between the markers of a part of a page, docs/speed.md by default."""
    page = page or SPEED_PAGE
    before, begin, rest = re.split(rf"(<!-- {part}\b[^\n]*-->\n)", page.read_text())
    _, end, after = rest.partition("<!-- end -->")
    if not end:
        raise ValueError(f"no end marker after the part {part} in {page}")
    page.write_text(f"{before}{begin}{text}\n{end}{after}")
