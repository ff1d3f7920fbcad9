"""Subscription requests of clients."""

from __future__ import annotations

from woosh_robot_agent.link.codecs.choice import server_codec
from woosh_robot_agent.link.codecs.frames import SUBSCRIPTION_TYPE, Envelope
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.protos import full_name

_TYPES = (SUBSCRIPTION_TYPE, full_name(Subscription))


def is_subscription(envelope: Envelope) -> bool:
    """Return True if a client's frame changes its subscriptions."""
    return envelope.type in _TYPES


def apply_subscription(topics: set[str], envelope: Envelope, frame: str | bytes) -> None:
    """Change a client's set of subscribed types as its frame requests.

    Raises:
        FrameError: The frame cannot be read.
    """
    subscription = server_codec(frame).body(envelope, Subscription)
    if subscription.sub:
        topics.update(subscription.topics)
    else:
        topics.difference_update(subscription.topics)
