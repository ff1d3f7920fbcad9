"""The error for values that must not be sent to the robot."""

from __future__ import annotations


class BadFieldError(ValueError):
    """A ROS message holds a value that must not be sent to the robot.

    Attributes:
        path: path of the field in the message, e.g. `poses[1].x`.
        reason: what is wrong with the value.
    """

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(f"{path} {reason}")
        self.path = path
        self.reason = reason

    def below(self, prefix: str) -> BadFieldError:
        """Return the same error for a message that holds this one in its field `prefix`."""
        return BadFieldError(f"{prefix}.{self.path}", self.reason)
