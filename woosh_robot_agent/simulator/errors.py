"""Error of a request that the robot refuses."""

from __future__ import annotations


class RefusedError(Exception):
    """The robot refuses a request. The text gives the reason and is sent to the client."""
