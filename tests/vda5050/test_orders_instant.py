"""Acceptance of instant actions and of their ids, and the check of actions."""

from __future__ import annotations

import pytest

from tests.vda5050.master import Message
from tests.vda5050.master import action as message
from tests.vda5050.orders import Robot, path, references
from woosh_robot_agent.vda5050.actions.runner import action_types
from woosh_robot_agent.vda5050.messages.factsheet import Scope, find_objection
from woosh_robot_agent.vda5050.messages.order import Action, BlockingType
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType, RejectedError
from woosh_robot_agent.vda5050.messages.versions import V2_1, V3_0
from woosh_robot_agent.vda5050.orders.instant import InstantActions
from woosh_robot_agent.vda5050.orders.structure import check_instant_ids

TYPES = action_types(V2_1)
LIFT = Action("lift", "liftTo", parameters={"height": 0.1})
PAUSE, RESUME = Action("pause", "startPause"), Action("resume", "stopPause")


class Vehicle:
    """Instant actions of a vehicle with an order, and what they have commanded."""

    def __init__(self) -> None:
        self.robot = Robot()
        self.instant = InstantActions(TYPES, self.robot.machine)

    def receive(self, *actions: Action) -> list[str]:
        """Receive actions; return the ids of those that start."""
        self.instant.receive(actions)
        return self.started()

    def started(self) -> list[str]:
        ids = [each.action.id for each in self.instant.commands]
        self.instant.commands.clear()
        return ids

    def end(self, action_id: str) -> list[str]:
        self.instant.changed(action_id, ActionStatus.FINISHED, "")
        return self.started()

    @property
    def reasons(self) -> list[str]:
        return [each.description for each in self.instant.errors]


def test_a_pause_counts_even_if_the_former_one_with_its_id_has_not_ended() -> None:
    vehicle = Vehicle()
    assert vehicle.receive(PAUSE, RESUME, PAUSE) == ["pause", "resume"]
    assert vehicle.end("pause") == ["pause"]
    assert vehicle.reasons == []


def test_a_stop_pause_also_ends_a_repeated_start_pause() -> None:
    vehicle = Vehicle()
    assert vehicle.receive(PAUSE, PAUSE, RESUME) == ["pause", "resume"]
    assert vehicle.end("pause") == []


def test_an_id_that_is_used_again_is_reported_if_nothing_is_done() -> None:
    vehicle = Vehicle()
    assert vehicle.receive(LIFT) == ["lift"]
    assert vehicle.receive(Action("lift", "startPause"), Action("lift", "startPause")) == []
    assert vehicle.reasons == ["the liftTo with this id has not ended"]
    vehicle.end("lift")
    assert vehicle.receive(LIFT) == []
    error = vehicle.instant.errors[-1]
    assert error.type == ErrorType.INSTANT_ACTION
    assert "liftTo is not performed again" in error.description
    assert references(error) == {"actionId": "lift", "actionType": "liftTo"}
    assert vehicle.receive(PAUSE) == ["pause"]


def test_an_action_of_an_order_and_an_instant_action_cannot_have_the_same_id() -> None:
    vehicle = Vehicle()
    vehicle.robot.give(path("ab", actions={"b": [Action("one", "pick")]}))
    assert vehicle.receive(Action("one", "stateRequest")) == []
    assert vehicle.reasons == ["an action of the order has this id"]
    with pytest.raises(RejectedError, match="an instant action has this id"):
        check_instant_ids(path("a", actions={"a": [LIFT]}), {"lift"})


def test_an_action_that_forbids_driving_holds_the_order_until_it_ends() -> None:
    vehicle = Vehicle()
    vehicle.receive(LIFT)
    vehicle.robot.give(path("ab"))
    assert vehicle.robot.legs == []
    vehicle.end("lift")
    vehicle.robot.poll()
    assert vehicle.robot.legs == ["b"]


def test_a_pause_is_performed_however_many_actions_run() -> None:
    vehicle = Vehicle()
    lifts = [Action(f"{number}", "liftTo", parameters={"height": 0.1}) for number in range(201)]
    assert len(vehicle.receive(*lifts)) == 200
    assert vehicle.receive(PAUSE) == ["pause"]


# The check of actions

POSE = {"x": 0.0, "y": 0.0, "theta": 0.0, "mapId": "wooshmap", "lastNodeId": "a"}
MAP = {"mapId": "m", "mapVersion": "1", "mapDownloadLink": "http://localhost/m.zip"}
NODE, INSTANT = Scope.NODE, Scope.INSTANT
WRONG = [
    (NODE, message("finePositioning"), "no action finePositioning", ""),
    (NODE, message("startPause"), "not possible as node action", ""),
    (NODE, message("step"), "needs the parameter distance", "distance"),
    (NODE, message("step", distance="1"), "must be a finite number", "distance"),
    (NODE, message("step", distance=100.0), "within -10 to 10", "distance"),
    (NODE, message("step", distance=1.0, lateral="yes"), "must be true or false", "lateral"),
    (NODE, message("step", blocking="NONE", distance=1.0), "needs blockingType HARD or SOFT", ""),
    (NODE, message("liftTo", height=99.0), "within 0 to 2", "height"),
    (NODE, message("liftTo", height=0.1, speed=0.0), "at least 0.001", "speed"),
    (NODE, message("speak", text=1), "must be a text", "text"),
    (NODE, message("switchFootprint", footprint="HUGE"), "one of ORIGINAL", "footprint"),
    (NODE, message("pick", side="left"), "has no parameter side", "side"),
    (NODE, message("initPosition", **POSE | {"theta": None}), "must be a finite number", "theta"),
    (INSTANT, message("pick"), "not possible as instant action, only as node action", ""),
    (INSTANT, message("stateRequest", all=True), "has no parameter all", "all"),
    (
        INSTANT,
        message("downloadMap", **MAP | {"mapDownloadLink": "file:///m"}),
        "URL",
        "mapDownloadLink",
    ),
    (INSTANT, message("downloadMap", **MAP | {"mapHash": "1"}), "hash of sha256, sha1", "mapHash"),
    (INSTANT, message("logReport", reason="none"), "no action logReport", ""),
]
"""Where an action is, the action, a part of the reason, and the parameter that is named."""


@pytest.mark.parametrize(("scope", "wrong", "reason", "parameter"), WRONG)
def test_a_wrong_action_has_a_reason(
    scope: Scope, wrong: Message, reason: str, parameter: str
) -> None:
    given = {each["key"]: each["value"] for each in wrong["actionParameters"]}
    found = find_objection(
        TYPES, Action("1", wrong["actionType"], BlockingType(wrong["blockingType"]), given), scope
    )
    assert found is not None
    assert reason in found.reason
    assert found.parameter == parameter


SCOPES: dict[str, set[Scope]] = {
    **{key: {Scope.INSTANT} for key in ("startPause", "stopPause", "cancelOrder")},
    **{key: {Scope.INSTANT} for key in ("stateRequest", "factsheetRequest")},
    **{key: {Scope.INSTANT} for key in ("downloadMap", "deleteMap")},
    **{key: {Scope.INSTANT, Scope.NODE} for key in ("startCharging", "stopCharging")},
    **{key: {Scope.INSTANT, Scope.NODE} for key in ("initPosition", "enableMap")},
    **{key: {Scope.INSTANT, Scope.NODE} for key in ("step", "rotate", "switchFootprint")},
    **{key: {Scope.NODE} for key in ("pick", "drop")},
    **{key: set(Scope) for key in ("liftTo", "speak")},
}
"""All actions in version 2.1, and where they may be requested."""


def test_a_text_may_be_empty_where_the_standard_gives_that_a_meaning() -> None:
    place = {"x": 0.0, "y": 0.0, "theta": 0.0, "mapId": "hall", "lastNodeId": ""}
    stand = Action("1", "initPosition", parameters=place)
    assert find_objection(TYPES, stand, Scope.INSTANT) is None
    load = Action("2", "pick", BlockingType.HARD, parameters={"loadId": ""})
    assert find_objection(TYPES, load, Scope.NODE) is None
    enable = Action("3", "enableMap", parameters={"mapId": "hall", "mapVersion": ""})
    assert find_objection(TYPES, enable, Scope.INSTANT) is None


def test_the_actions_of_each_version() -> None:
    second, third = TYPES.keys(), action_types(V3_0).keys()
    assert second == SCOPES.keys()
    assert second - third == {"initPosition"}
    assert third - second == {"initializePosition", "clearInstantActions"}
