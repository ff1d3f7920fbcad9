"""Quality-of-service profiles of the agent's topics and services."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

SERVICE_QOS = QoSProfile(depth=10_000)
"""Profile of all services, those of actions included.

DDS silently drops requests and responses that exceed the depth. It asks for lost samples every 3 s;
this depth holds those of 5 s at 2,000 calls/s."""

FEEDBACK_QOS = QoSProfile(depth=1000)
"""Profile of the feedback of all actions.

Each report of the chassis is feedback, and must reach a client that is slow for a while."""

RARE_QOS = QoSProfile(depth=10)
"""Profile of services that are seldom called, and of feedback at 10 Hz.

DDS reserves memory by the depth: an action with the profiles above takes 150 KiB more."""


def reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    """Return the profile of a reliable topic with a queue of `depth` messages."""
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


def latched(depth: int) -> QoSProfile:
    """Return the profile of a latched topic: late subscribers get the last `depth` messages."""
    return reliable(depth, DurabilityPolicy.TRANSIENT_LOCAL)
