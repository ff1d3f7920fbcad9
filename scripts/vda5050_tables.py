"""Tables of docs/vda5050_reference.md: actions, errors and fields, from the code."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterable, Iterator, Mapping

from scripts.markdown_table import table
from woosh_robot_agent.vda5050.actions.runner import ACTIONS
from woosh_robot_agent.vda5050.messages.factsheet import STANDSTILL, ActionType
from woosh_robot_agent.vda5050.messages.state import ErrorType
from woosh_robot_agent.vda5050.messages.versions import OBEYED_ANYWAY, V2_1, V3_0

_REFUSED = [
    f"edges.{name}{'.*' if name == 'corridor' else ''}"
    for name in dict.fromkeys((*V2_1.unsupported_edge_fields, *V3_0.unsupported_edge_fields))
    if name not in OBEYED_ANYWAY
]
_NO_VALUE = "the robot reports no such value"
_NO_ZONES = "the robot has no zones or corridors of a fleet control"
_NO_LOADS = "the robot knows nothing else about its load"

UNSUPPORTED: Mapping[str, Mapping[str, Iterable[str]]] = {
    "order": {
        "refused, by its name in `errorReferences`; `zoneSetId` unless empty, `retriable` unless "
        "`false`": [*_REFUSED, "zoneSetId", "nodes.actions.retriable", "edges.actions.retriable"],
        "information for people": ["orderDescription", "nodes.nodePosition.mapDescription"],
        "not needed: the robot measures its way": ["edges.length"],
    },
    "instantActions": {"an action that fails is not repeated": ["actions.retriable"]},
    "zoneSet": {"refused with `UNSUPPORTED_PARAMETER`: the robot takes no zones": ["zoneSet.*"]},
    "responses": {"not subscribed: the vehicle makes no requests": ["responses.*"]},
    "visualization": {
        "in the state": ["plannedPath.*"],
        "the robot reports no arrival times": ["intermediatePath.*"],
        _NO_VALUE: [
            "agvPosition.localizationScore",
            "mobileRobotPosition.localizationScore",
            "agvPosition.deviationRange",
            "mobileRobotPosition.deviationRange",
        ],
    },
    "state": {
        "maps have no description": [
            "maps.mapDescription",
            "maps.mapDescriptor",
            "agvPosition.mapDescription",
        ],
        _NO_ZONES: [
            "zoneSetId",
            "zoneSets.*",
            "zoneRequests.*",
            "edgeRequests.*",
            "zoneActionStates.*",
        ],
        "the defaults hold": [
            "plannedPath.trajectory.knotVector",
            "plannedPath.trajectory.controlPoints.weight",
        ],
        "the robot tells neither nodes nor times of its path": [
            "plannedPath.traversedNodes",
            "intermediatePath.*",
        ],
        _NO_LOADS: [
            "loads.loadId",
            "loads.loadType",
            "loads.loadPosition",
            "loads.boundingBoxReference.*",
            "loads.loadDimensions.*",
            "loads.weight",
        ],
        _NO_VALUE: [
            "agvPosition.localizationScore",
            "mobileRobotPosition.localizationScore",
            "agvPosition.deviationRange",
            "mobileRobotPosition.deviationRange",
            "batteryState.batteryVoltage",
            "powerSupply.batteryVoltage",
            "powerSupply.batteryCurrent",
            "batteryState.reach",
            "powerSupply.range",
        ],
        "texts are in English": [
            "errors.errorDescriptionTranslations.*",
            "errors.errorHintTranslations.*",
        ],
        "nothing to tell": ["information.*"],
    },
    "factsheet": {
        _NO_VALUE: [
            "physicalParameters.minimumAngularSpeed",
            "physicalParameters.maximumAngularSpeed",
            "agvGeometry.wheelDefinitions.*",
            "agvGeometry.envelopes3d.*",
            "mobileRobotGeometry.wheelDefinitions.*",
            "mobileRobotGeometry.envelopes3d.*",
            "mobileRobotConfiguration.batteryCharging.*",
        ],
        "there is no such limit": [
            "protocolLimits.maxStringLens.*",
            "protocolLimits.maximumStringLengths.*",
            "protocolLimits.maxArrayLens.*",
            "protocolLimits.maximumArrayLengths.*",
        ],
        "no list fits the published schema of 2.1.0": ["protocolFeatures.agvActions.blockingTypes"],
        "the outline needs none": [
            "agvGeometry.envelopes2d.description",
            "mobileRobotGeometry.envelopes2d.description",
        ],
        _NO_LOADS: ["loadSpecification.loadPositions", "loadSpecification.loadSets.*"],
        "the connector, not the robot, is at the broker": [
            "vehicleConfig.network.*",
            "mobileRobotConfiguration.network.*",
        ],
    },
}
"""Fields that the vehicle does not obey or send, by topic and reason.

They have the names of either version. `.*` stands for a field with all fields below it, except
those that are sent.
"""
REMARKS: Mapping[str, Mapping[str, str]] = {
    "order": {
        "nodes.nodePosition": "without it, `nodeId` must be the number of a mark on the robot's "
        "map",
        "nodes.nodePosition.theta": "the robot stops and turns, unless `allowedDeviationTheta` "
        "permits any heading",
        "nodes.nodePosition.allowedDeviationXY": "a radius; in 3.0 an ellipse with `theta` within "
        "±π/2; each axis counts as at least 0.25 m",
        "edges.maxSpeed": "at least 0.05 m/s; the robot slows down 1.5 m before a slower edge",
        "edges.orientation": "only 0 with `TANGENTIAL`: the robot drives forwards",
        "edges.rotationAllowed": "only `true`",
        "edges.reachOrientationBeforeEntering": "only `false`",
        "edges.trajectory": "driven strictly, from node to node, at most 0.5 m from the robot; "
        "degree 1 to 5, 500 control points, 2,000 in an order",
    },
    "instantActions": {"actions.blockingType": "in 3.0 it must be `NONE`"},
    "connection": {"connectionState": "never `HIBERNATING`"},
    "state": {
        "maps": "if they are known; not with `--no-maps-in-state`",
        "distanceSinceLastNode": "during an order",
        "plannedPath": "from the robot to the end of its task, as straight pieces within 2 cm",
        "loads": "if the robot detects loads: one, or none",
        "actionStates.actionStatus": "`PAUSED` in 3.0 only; the schema of 2.1 lacks it",
    },
    "factsheet": {
        "physicalParameters.speedMax": "always 1 m/s; accelerations 0.5 m/s²",
        "protocolFeatures.mobileRobotActions.pauseAllowed": "as text, like `cancelAllowed`: the "
        "published schema of 3.0.0 demands it",
        "typeSpecification.mobileRobotKinematic": "beside `mobileRobotKinematics`, for the same "
        "reason",
    },
}
"""What the vehicle does with other fields, by topic, as far as it is not obvious."""


def actions() -> str:
    """Return the table of the actions."""
    return table(("Action", "Where", "What the robot does", "Parameters"), _action_rows())


def _action_rows() -> Iterator[tuple[str, ...]]:
    for action in ACTIONS.values():
        kind = action.type
        name = f"`{kind.name}`" + (f" ({action.version}.x)" if action.version else "")
        scopes = ", ".join(sorted(each.value.lower() for each in kind.scopes))
        parameters = (f"[`{e.key}`]" if e.optional else f"`{e.key}`" for e in kind.parameters)
        yield name, scopes, _description(kind), ", ".join(parameters)


def _description(kind: ActionType) -> str:
    blocking = "; SOFT or HARD" if kind.blocking == STANDSTILL else ""
    return f"{kind.description}{blocking}{'; any id' if kind.repeatable else ''}"


def errors() -> str:
    """Return the table of the errors."""
    # the docstrings of the members of an enum are only in its source
    tree = ast.parse(inspect.getsource(ErrorType))
    texts = [
        each.value.value
        for each in tree.body[0].body  # type: ignore[attr-defined]
        if isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
    ][1:]  # without the docstring of the class
    rows = []
    for kind, text in zip(ErrorType, texts, strict=True):
        names = (version.error_type(kind.value) for version in (V2_1, V3_0))
        cells = (f"`{name}`" if name else "none" for name in names)
        rows.append((*cells, " ".join(str(text).removesuffix(".").split())))
    return table(("2.1", "3.0", "When"), rows)


def names() -> str:
    """Return the names of fields that differ between the versions, as text."""
    pairs = [(old, new) for old, new in V3_0.names.items() if new and "." not in old]
    return ", ".join(f"`{old}`: `{new}`" for old, new in sorted(pairs)) + "."


def fields() -> str:
    """Return the table of the fields that the vehicle does not simply obey or send."""
    rows = []
    for topic in dict.fromkeys((*REMARKS, *UNSUPPORTED)):
        rows += [(topic, f"`{name}`", text) for name, text in REMARKS.get(topic, {}).items()]
        for reason, patterns in UNSUPPORTED.get(topic, {}).items():
            rows.append((topic, ", ".join(f"`{each}`" for each in patterns), f"no: {reason}"))
    return table(("Topic", "Fields", "Vehicle"), rows)
