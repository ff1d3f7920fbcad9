"""The error of a survey."""

from __future__ import annotations


class SurveyError(Exception):
    """A survey cannot be made, or its folder cannot be written."""
