"""Result of one check."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Status(Enum):
    """Outcome of a check."""

    OK = "ok"
    WARN = "warn"
    FAIL = "FAIL"
    SKIPPED = "skip"


@dataclass(frozen=True)
class Result:
    """Result of one check.

    Attributes:
        status: Outcome.
        text: What was found.
        remedy: What to do about it; empty if nothing has to be done.
        check: Name of the check; filled in by `examine`.
    """

    status: Status
    text: str
    remedy: str = ""
    check: str = ""


class CheckFailedError(Exception):
    """A check failed on which all later ones depend.

    Attributes:
        result: Result of the check.
    """

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.result = Result(Status.FAIL, text, remedy)
