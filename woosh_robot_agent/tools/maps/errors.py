"""The error that ends the program."""

from __future__ import annotations


class MapsError(Exception):
    """The program cannot do what it was told. The text says why, and what to do."""
