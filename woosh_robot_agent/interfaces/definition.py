"""The text of an interface file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """A line that defines a field or a constant.

    Attributes:
        definition: the line, e.g. `uint8 has_field 255`.
        comment: text of the comment above it; empty for none.
    """

    definition: str
    comment: str = ""


def message_text(comment: str, *blocks: Sequence[Line]) -> str:
    """Return the content of a .msg file.

    Args:
        comment: comment at the top of the file.
        blocks: lines that stand together; an empty line precedes each block.
    """
    return "\n".join([_comment(comment), *map(_block, filter(None, blocks))])


def parts_text(comment: str, *parts: Sequence[Line]) -> str:
    """Return the content of a .srv or .action file.

    Args:
        comment: comment at the top of the file.
        parts: fields of each part.
    """
    return f"{_comment(comment)}\n" + "---\n".join(map(_block, parts))


def _block(lines: Sequence[Line]) -> str:
    return "".join(f"{_comment(line.comment)}{line.definition}\n" for line in lines)


def _comment(text: str) -> str:
    return "".join(f"# {line.strip()}".rstrip() + "\n" for line in text.strip().splitlines())
