"""How the model says no."""

from __future__ import annotations


class Refused(Exception):
    """A request that the chassis does not take; its text says why and goes to the client."""
