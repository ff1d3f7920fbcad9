"""Quality-of-service profiles of the agent's topics and services."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile

SERVICE_QOS = QoSProfile(depth=10_000)
"""Profile of all services, including the services of actions.

DDS silently drops requests and responses that exceed the depth, and repeats lost samples only every
3 s. This depth holds 5 s of requests at 2,000 calls/s."""

FEEDBACK_QOS = QoSProfile(depth=1000)
"""Profile of the feedback of all actions.

Each report of the chassis is feedback, and must reach a client that is slow for a while."""

RARE_QOS = QoSProfile(depth=10)
"""Profile of services that are seldom called, and of feedback at 10 Hz.

DDS reserves memory by the depth: an action with `SERVICE_QOS` and `FEEDBACK_QOS` takes 150 KiB
more."""


def latched(depth: int) -> QoSProfile:
    """Return the profile of a latched topic: late subscribers get the last `depth` messages."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)
