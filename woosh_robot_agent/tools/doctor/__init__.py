"""The program `doctor`: checks the connection to a robot and whether it accepts tasks."""

from __future__ import annotations


class SurveyError(Exception):
    """A survey cannot be made, or its folder cannot be written."""
