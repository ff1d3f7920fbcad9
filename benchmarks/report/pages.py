"""The parts of docs/speed.md that benchmarks write."""

from __future__ import annotations

import re

from benchmarks.processes import ROOT

DOCS = ROOT / "docs"
SPEED_PAGE = DOCS / "speed.md"


def write_part(part: str, text: str) -> None:
    """Replace the text between the markers of a part of docs/speed.md."""
    before, begin, rest = re.split(rf"(<!-- {part}\b[^\n]*-->\n)", SPEED_PAGE.read_text())
    _, end, after = rest.partition("<!-- end -->")
    if not end:
        raise ValueError(f"no end marker after the part {part} in {SPEED_PAGE}")
    SPEED_PAGE.write_text(f"{before}{begin}{text}\n{end}{after}")
