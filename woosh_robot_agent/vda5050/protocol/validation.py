"""Validation of messages with the published JSON schemas."""

from __future__ import annotations

import functools
import itertools
import json
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from jsonschema.protocols import Validator

SCHEMAS = Path(__file__).with_name("schemas")
"""Folder of the schemas, with a folder for each version of the standard."""
_MAX_ERRORS = 100
"""Maximum number of schema errors from which the most relevant one is chosen."""


@functools.cache
def validator(version: str, topic: str) -> Validator:
    """Return the validator of a message.

    Args:
        version: version of the standard, e.g. `2.1.0`.
        topic: last level of the topic, e.g. `order`.
    """
    text = (SCHEMAS / version / f"{topic}.schema").read_text("utf-8")
    return Draft202012Validator(
        json.loads(text), format_checker=Draft202012Validator.FORMAT_CHECKER
    )


def defect(version: str, topic: str, message: Any) -> tuple[str, str] | None:
    """Validate a message; return the path of an invalid field and the reason, or None."""
    errors = itertools.islice(validator(version, topic).iter_errors(message), _MAX_ERRORS)
    error = best_match(errors)
    if error is None:
        return None
    path = ".".join(str(part) for part in error.absolute_path)
    return path, _short(error.message)


def _short(text: str, limit: int = 200) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."
