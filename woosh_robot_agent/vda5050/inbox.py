"""Messages of the master control: from bytes to values of the model."""

from __future__ import annotations

import json
from typing import Any

from woosh_robot_agent.vda5050.model.errors import (
    ErrorType,
    RejectedError,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.model.order import Action, Order
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.topics import Topic
from woosh_robot_agent.vda5050.protocol.validation import defect


def read_order(payload: bytes, version: Version) -> Order:
    """Return a received order.

    Raises:
        RejectedError: the message is malformed.
    """
    return version.order(_parse(payload, version, Topic.ORDER))


def read_instant_actions(payload: bytes, version: Version) -> list[Action]:
    """Return received instant actions.

    Raises:
        RejectedError: the message is malformed.
    """
    return version.instant_actions(_parse(payload, version, Topic.INSTANT_ACTIONS))


def refusal_of_zone_set(payload: bytes, version: Version) -> VehicleError:
    """Return the error for a received zone set: the robot takes no zones of a fleet control."""
    try:
        message = _parse(payload, version, Topic.ZONE_SET)
    except RejectedError as rejected:
        return rejected.error
    return warning(
        ErrorType.UNSUPPORTED_PARAMETER,
        "the robot takes no zones",
        "send no zone sets: supportedZones of the factsheet is empty",
        topic=Topic.ZONE_SET.value,
        zoneSetId=message["zoneSet"]["zoneSetId"],
    )


def _parse(payload: bytes, version: Version, topic: Topic) -> dict[str, Any]:
    """Return a message of the master control.

    Raises:
        RejectedError: it is malformed.
    """
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise RejectedError(
            warning(
                ErrorType.VALIDATION,
                f"the message on {topic.value} is no JSON: {error}",
                "correct the message and send it again",
                topic=topic.value,
            )
        ) from None
    found = defect(version.number, topic.value, message)
    if found is None:
        return message  # type: ignore[no-any-return]
    field_path, reason = found
    references = {
        key: message[key]
        for key in ("headerId", "orderId", "orderUpdateId")
        if isinstance(message, dict) and key in message
    }
    raise RejectedError(
        warning(
            ErrorType.VALIDATION,
            f"the message on {topic.value} is malformed at {field_path or 'its top'}: {reason}",
            "correct the message and send it again",
            topic=topic.value,
            **references,
        )
    )
