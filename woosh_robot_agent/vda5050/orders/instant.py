"""Instant actions and their states."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence, Set
from dataclasses import replace
from itertools import takewhile

from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.messages.factsheet import (
    ActionType,
    ActionTypes,
    Objection,
    Scope,
    find_objection,
)
from woosh_robot_agent.vda5050.messages.order import Action, BlockingType
from woosh_robot_agent.vda5050.messages.state import (
    ActionState,
    ActionStatus,
    ErrorType,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.orders.legs import EndAction, Perform
from woosh_robot_agent.vda5050.orders.machine import OrderMachine

START_PAUSE, STOP_PAUSE, CANCEL_ORDER = "startPause", "stopPause", "cancelOrder"
"""Names of actions for which special rules apply in `orders` or `execution`."""
_MAP_ACTIONS = frozenset({"enableMap", "downloadMap", "deleteMap"})
"""Actions that end the error of a duplicate map when they are accepted."""
_MAX_STATES = 200
"""Maximum number of instant actions in the state. If there are more, the oldest ended actions are
forgotten; a new action fails if as many actions still run."""
_MAX_KNOWN = 500
"""Maximum number of ids of instant actions that are remembered; the oldest ids are forgotten."""
_MAX_ERRORS = 20
"""Maximum number of errors of actions; the oldest ones are forgotten."""

_HOLD_PREFIX = "action "
"""Beginning of the name of a hold (reason for which the order must not drive) of an instant action;
the id of the action follows."""

_TOO_MANY = Sentence("more than {most} instant actions run")
_RUNS = Sentence("the {action} with this id has not ended")
_IN_ORDER = Sentence("an action of the order has this id")
_AGAIN = Sentence(
    "an instant action with this id was received before, and {action} is not performed again"
)


class InstantActions:
    """The instant actions in the state of the vehicle, and the ids of earlier ones.

    Actions stay in the state until `forget_ended`, or until there are too many.

    Args:
        order: the current order, which must not drive while an instant action forbids driving.

    Attributes:
        commands: commands that start or end actions; `Execution` takes them.
        last_motion: id of the last instant action that moves something, for `Record.last_motion`;
            empty if there was none since the start of the program.
        errors: the last errors of refused instant actions, and of all actions that failed.
    """

    def __init__(self, types: ActionTypes, order: OrderMachine) -> None:
        self._types = types
        self._order = order
        self._states: dict[str, ActionState] = {}
        """The instant actions in the state, by id."""
        self._known: dict[str, None] = {}
        """Ids of the last instant actions, the oldest first; a dict serves as an ordered set."""
        self.commands: list[Perform | EndAction] = []
        self._pause_again: dict[str, Action] = {}
        """Repeated startPause actions, by id: they came while a startPause with the same id was
        running, and are received again when that one has ended."""
        self.last_motion = ""
        self.errors: deque[VehicleError] = deque(maxlen=_MAX_ERRORS)

    @property
    def states(self) -> tuple[ActionState, ...]:
        """States of the instant actions."""
        return tuple(self._states.values())

    @property
    def known_ids(self) -> tuple[str, ...]:
        """Ids of the last instant actions."""
        return tuple(self._known)

    def runs(self, action_type: str) -> bool:
        """Return True while an action of this type has not ended."""
        return any(
            state.type == action_type and not state.status.ended for state in self._states.values()
        )

    def ids_in_state(self, *, ended: bool) -> set[str]:
        """Return the ids of the actions in the state.

        Args:
            ended: True to include the actions that have ended.
        """
        return {key for key, state in self._states.items() if ended or not state.status.ended}

    def unfinished_before(self, action_id: str) -> list[ActionState]:
        """Return the actions that came before another one and have not ended.

        Those that control the vehicle itself, e.g. pauses, are left out.
        """
        earlier = takewhile(lambda state: state.id != action_id, self._states.values())
        return [
            state
            for state in earlier
            if not state.status.ended and not self._types[state.type].controls_vehicle
        ]

    def cancel_before(self, action_id: str) -> None:
        """Add commands to end the actions of `unfinished_before`."""
        for state in self.unfinished_before(action_id):
            action = Action(state.id, state.type)
            self.commands.append(EndAction(action, "cancelled by cancelOrder"))

    def receive(self, actions: Sequence[Action]) -> set[str]:
        """Begin instant actions; refuse those that are impossible or reuse an id wrongly.

        Returns:
            The types of the actions that were not refused.
        """
        accepted: set[str] = set()
        for action in actions:
            if action.type == STOP_PAUSE:  # also ends the repeated pauses that wait for their start
                self._pause_again.clear()
            if self._repeats_running_pause(action):
                # not refused, because a stopPause may have arrived since the first one
                self._pause_again[action.id] = action
                continue
            if reason := self._reuse_objection(action):
                self._refuse(action, Objection(reason), "use each actionId once")
                continue
            for ids in (self._known, self._states):
                ids.pop(action.id, None)  # moves a repeated id to the end
            self._known[action.id] = None
            self._states[action.id] = ActionState(
                action.id, action.type, ActionStatus.WAITING, description=action.description
            )
            objection = find_objection(self._types, action, Scope.INSTANT)
            if self._is_too_many(action.type):
                objection = Objection(_TOO_MANY(most=_MAX_STATES))
            if objection is not None:
                self._refuse(action, objection, "see the factsheet for the actions of the vehicle")
                self.changed(action.id, ActionStatus.FAILED, objection.reason)
            else:
                self._start(action, self._types[action.type])
                accepted.add(action.type)
        self._forget_oldest()
        return accepted

    def restore(self, states: Sequence[ActionState], known_ids: Sequence[str]) -> None:
        """Restore the states after a restart; the order must have been restored before.

        Actions that ran fail, except `cancelOrder`, which is performed again. If one of them
        forbade driving, the order is interrupted, because the robot may still execute the action.

        Args:
            states: the saved states; the changes of the last seconds may be missing.
        """
        self._known.update(dict.fromkeys(known_ids))
        holds = sorted(hold for hold in self._order.holds if hold.startswith(_HOLD_PREFIX))
        for state in states:
            self._states[state.id] = state
            if state.status.ended:
                continue
            if state.type == CANCEL_ORDER:
                action = Action(state.id, state.type, description=state.description)
                self.commands.append(Perform(action, at_once=True))
            else:
                self.changed(state.id, ActionStatus.FAILED, "the connector was restarted")
        self._order.holds.difference_update(holds)
        for hold in holds:
            self._order.interrupt(hold.removeprefix(_HOLD_PREFIX))

    def changed(self, action_id: str, status: ActionStatus, result: str) -> bool:
        """Store the new status of an action; return False if it is not an instant action.

        When a startPause ends, also begin a repeated one that waits for this.
        """
        state = self._states.get(action_id)
        if state is None:
            return False
        self._states[action_id] = replace(state, status=status, result=result)
        if status.ended:
            self._order.holds.discard(_hold_of(action_id))
            if again := self._pause_again.pop(action_id, None):
                self.receive([again])
        return True

    def failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        """Report the error of a failed action, which may also be one of the order."""
        keys = ("mapId", "mapVersion") if kind is ErrorType.DUPLICATE_MAP else ()
        references = {key: action.parameters[key] for key in keys}
        self._add_error(
            warning(kind, reason, actionId=action.id, actionType=action.type, **references)
        )

    def forget_ended(self) -> None:
        """Forget the actions that have ended, and the errors except those that a new order ends."""
        self._states = {key: state for key, state in self._states.items() if not state.status.ended}
        kept = ErrorType.NO_ORDER_TO_CANCEL.value
        former, self.errors = self.errors, deque(maxlen=_MAX_ERRORS)
        self.errors += [each for each in former if each.type == kept]

    def end_errors(self, former: Iterable[VehicleError], accepted: Set[str]) -> None:
        """Forget errors that end when actions are accepted, as version 3 demands.

        Args:
            former: the errors that were reported before.
            accepted: types of the accepted actions.
        """
        ended = {ErrorType.INSTANT_ACTION.value} if accepted else set()
        if not accepted.isdisjoint(_MAP_ACTIONS):
            ended.add(ErrorType.DUPLICATE_MAP.value)
        ended_ids = {id(error) for error in former if error.type in ended}
        kept = [error for error in self.errors if id(error) not in ended_ids]
        self.errors = deque(kept, maxlen=_MAX_ERRORS)

    def _is_too_many(self, action_type: str) -> bool:
        """Return True if too many actions run, now that an action of this type is among them.

        Pauses and cancellations are counted separately, so that no number of other actions
        prevents a pause.
        """
        stops = (START_PAUSE, STOP_PAUSE, CANCEL_ORDER)
        running = [each.type for each in self._states.values() if not each.status.ended]
        counted = [each for each in running if (each in stops) == (action_type in stops)]
        return len(counted) > _MAX_STATES

    def _start(self, action: Action, kind: ActionType) -> None:
        """Add the command to perform an action; hold the order if the action forbids driving."""
        if kind.controls_vehicle:  # it ignores its blockingType
            self.commands.append(Perform(action, at_once=True))
            return
        if kind.moves:
            self.last_motion = action.id
        # any type is accepted (version 3.0 has only NONE), but this action needs a standstill
        if action.blocking not in kind.blocking:
            action = replace(action, blocking=BlockingType.HARD)
        if action.blocking.forbids_driving:
            self._order.holds.add(_hold_of(action.id))
        self.commands.append(Perform(action))

    def _repeats_running_pause(self, action: Action) -> bool:
        """Return True for a startPause with the id of a startPause that has not ended."""
        state = self._states.get(action.id)
        if state is None or state.status.ended:
            return False
        return state.type == action.type == START_PAUSE

    def _reuse_objection(self, action: Action) -> str:
        """Return why an action may not reuse the id of an earlier action; empty if it may."""
        state = self._states.get(action.id)
        if state is not None and not state.status.ended:
            return _RUNS(action=state.type)
        if self._order.has_action(action.id):
            return _IN_ORDER()
        kind = self._types.get(action.type)
        if action.id in self._known and not (kind is not None and kind.repeatable):
            return _AGAIN(action=action.type)
        return ""

    def _refuse(self, action: Action, objection: Objection, hint: str) -> None:
        """Report why an instant action is refused."""
        self._add_error(
            warning(
                ErrorType.INSTANT_ACTION,
                objection.reason,
                hint,
                actionId=action.id,
                actionType=action.type,
                **objection.references,
            )
        )

    def _add_error(self, error: VehicleError) -> None:
        """Report an error, once and as the newest if it is reported already."""
        if error in self.errors:
            self.errors.remove(error)
        self.errors.append(error)

    def _forget_oldest(self) -> None:
        """Forget the oldest actions that have ended, and the oldest ids, if there are too many."""
        surplus = len(self._states) - _MAX_STATES
        ended = [key for key, state in self._states.items() if state.status.ended]
        for key in ended[: max(0, surplus)]:
            del self._states[key]
        for key in tuple(self._known)[:-_MAX_KNOWN]:
            del self._known[key]


def _hold_of(action_id: str) -> str:
    return f"{_HOLD_PREFIX}{action_id}"
