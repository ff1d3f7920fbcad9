"""The parts of docs/speed.md that measurements write."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = DOCS / "speed.md"


def write(part: str, text: str) -> None:
    """Replace what is between the marks of a part."""
    before, begin, rest = re.split(rf"(<!-- {part}\b[^\n]*-->\n)", PAGE.read_text())
    _, end, after = rest.partition("<!-- end -->")
    if not end:
        raise ValueError(f"{PAGE} has no end of the part {part}")
    PAGE.write_text(f"{before}{begin}{text}\n{end}{after}")
