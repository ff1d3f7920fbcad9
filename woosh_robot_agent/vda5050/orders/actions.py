"""The actions of an order: when they start, by their blocking types, and their states."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from woosh_robot_agent.vda5050.messages.order import Action, Edge, Node
from woosh_robot_agent.vda5050.messages.state import ActionState, ActionStatus
from woosh_robot_agent.vda5050.orders.legs import Command, EndAction, Perform, need_standstill


def count_startable(waiting: Iterable[Action], running: Iterable[Action], *, driving: bool) -> int:
    """Return the number of waiting actions that may start now; they start in their order.

    Args:
        waiting: triggered actions, in the order in which they must start.
        running: actions that run, all of them started by this rule.
    """
    # it is enough to look at one running action: if one excludes others, it runs alone
    other = next(iter(running), None)
    count = 0
    for action in waiting:
        if driving and action.blocking.forbids_driving:
            break
        if other and (other.blocking.excludes_actions or action.blocking.excludes_actions):
            break
        other = action
        count += 1
    return count


@dataclass(frozen=True)
class ActionsMemory:
    """State of the actions of an order that must survive a restart of the program.

    Attributes:
        triggered: triggered actions that have not started.
        running: actions with a `Perform` command that have not ended; WAITING ones have not begun.
        of_edge: actions of the edge on which the vehicle drives.
    """

    states: tuple[ActionState, ...] = ()
    triggered: tuple[Action, ...] = ()
    running: tuple[Action, ...] = ()
    of_edge: tuple[Action, ...] = ()


class OrderActions:
    """The actions of the current order.

    An action is triggered when its node is reached or its edge entered, and starts when its
    blocking type permits it.

    Attributes:
        triggered: triggered actions that have not started, in the order in which they must start.
        running: actions that have started and not ended, by id.
        commands: commands that `OrderMachine.poll` returns next. The machine adds its commands
            about the drive here too, so that all commands keep their order.
    """

    def __init__(self) -> None:
        self._states: dict[str, ActionState] = {}
        """States of all actions, by id."""
        self.triggered: list[Action] = []
        self.running: dict[str, Action] = {}
        self._edge_actions: tuple[Action, ...] = ()
        """Actions of the edge that the vehicle is on."""
        self.commands: list[Command] = []

    @property
    def states(self) -> tuple[ActionState, ...]:
        return tuple(self._states.values())

    def need_standstill(self) -> bool:
        """Return True if the vehicle must not drive because of a running or triggered action."""
        return need_standstill((*self.triggered, *self.running.values()))

    @property
    def memory(self) -> ActionsMemory:
        """State that must survive a restart of the program."""
        return ActionsMemory(
            states=self.states,
            triggered=tuple(self.triggered),
            running=tuple(self.running.values()),
            of_edge=self._edge_actions,
        )

    def restore(self, memory: ActionsMemory) -> None:
        """Restore the actions after a restart.

        Those that ran count as running until `interrupt` lets them fail. Those that were WAITING
        for other actions have not begun, and are triggered again.
        """
        self._states = {state.id: state for state in memory.states}
        waiting = {state.id for state in memory.states if state.status is ActionStatus.WAITING}
        self.triggered = [action for action in memory.running if action.id in waiting]
        self.triggered += memory.triggered
        self.running = {action.id: action for action in memory.running if action.id not in waiting}
        self._edge_actions = memory.of_edge

    def ids_without(self, parts: Iterable[Node | Edge]) -> set[str]:
        """Return the ids of all actions except those of some nodes and edges."""
        return self._states.keys() - {action.id for part in parts for action in part.actions}

    def clear(self) -> None:
        """Forget all actions; they must have ended."""
        self._states.clear()
        self._edge_actions = ()

    def add(self, parts: Iterable[Node | Edge]) -> None:
        """Add the actions of nodes and edges."""
        for part in parts:
            for action in part.actions:
                self._states[action.id] = ActionState(
                    action.id, action.type, ActionStatus.WAITING, description=action.description
                )

    def remove(self, parts: Iterable[Node | Edge]) -> None:
        """Forget the actions of nodes and edges."""
        for part in parts:
            for action in part.actions:
                self._states.pop(action.id, None)

    def trigger_node(self, node: Node) -> None:
        """Trigger the actions of a node that the vehicle has reached."""
        self.triggered += node.actions

    def fail_node(self, node: Node) -> None:
        """Let the actions of a node fail, because no report showed the vehicle near the node."""
        for action in node.actions:
            self.set_status(action.id, ActionStatus.FAILED, "the vehicle passed the node unseen")

    def trigger_edge(self, edge: Edge) -> None:
        """Trigger the actions of an edge that the vehicle enters."""
        self._edge_actions = edge.actions
        self.triggered += edge.actions

    def leave_edge(self) -> None:
        """End the actions of the edge that the vehicle leaves."""
        ids = {action.id for action in self._edge_actions}
        waiting = {action.id for action in self.triggered}
        self.triggered = [action for action in self.triggered if action.id not in ids]
        reason = "the vehicle has left the edge"
        for action in self._edge_actions:
            if action.id in waiting:
                self.set_status(action.id, ActionStatus.FAILED, reason)
            elif action.id in self.running:
                self.commands.append(EndAction(action, reason))
        self._edge_actions = ()

    def start(self, *, driving: bool) -> None:
        """Start the actions that may start now."""
        count = count_startable(self.triggered, self.running.values(), driving=driving)
        started, self.triggered = self.triggered[:count], self.triggered[count:]
        for action in started:
            self.running[action.id] = action
            self.set_status(action.id, ActionStatus.INITIALIZING)
            self.commands.append(Perform(action))

    def set_status(self, action_id: str, status: ActionStatus, result: str = "") -> None:
        """Store the new status of an action, unless the action has ended."""
        state = self._states.get(action_id)
        if state is None or state.status.ended:
            return
        self._states[action_id] = replace(state, status=status, result=result)
        if status.ended:
            self.running.pop(action_id, None)

    def interrupt(self, reason: str) -> Sequence[Action]:
        """Let all running actions fail, and return them."""
        interrupted = tuple(self.running.values())
        for action in interrupted:
            self.set_status(action.id, ActionStatus.FAILED, reason)
        return interrupted

    def cancel(self, reason: str) -> None:
        """Let waiting actions fail, and end running actions; drop the commands not taken yet."""
        for action_id, state in self._states.items():
            if action_id not in self.running and not state.status.ended:
                self._states[action_id] = replace(state, status=ActionStatus.FAILED, result=reason)
        self.triggered.clear()
        self.commands = [EndAction(action, reason) for action in self.running.values()]
