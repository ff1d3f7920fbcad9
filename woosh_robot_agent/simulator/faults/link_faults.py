"""Faults of the connection as a whole."""

from __future__ import annotations

from woosh_robot_agent.simulator.faults.fault import End, Fault, Injection, Target
from woosh_robot_agent.simulator.faults.parameters import Parameter


def _drop(target: Target, injection: Injection) -> None:
    target.drop()


def _accept_then_drop(target: Target, injection: Injection) -> End:
    def turn_away() -> bool:
        injection.hit()
        return False

    return target.hooks.screen(turn_away)


def _off(target: Target, injection: Injection) -> End:
    target.switch(False)
    return lambda: target.switch(True)


def _half_open(target: Target, injection: Injection) -> End:
    target.hold_link(True)
    return lambda: target.hold_link(False)


def _freeze(target: Target, injection: Injection) -> End:
    target.hang(True)
    return lambda: target.hang(False)


FAULTS = (
    Fault("drop", "every connection ends, as with a broken cable", _drop, lasting=False),
    Fault(
        "accept_then_drop",
        "each new connection is accepted, its handshake answered, and ended at once",
        _accept_then_drop,
        (Parameter("count", int, 0, "how many connections; 0: all", low=0),),
    ),
    Fault(
        "off",
        "every connection ends and new ones are refused, as if switched off; "
        "it comes back at the same ports",
        _off,
        shared=True,
    ),
    Fault(
        "half_open",
        "nothing is read or written any more, new connections included, but the sockets stay "
        "open; afterwards it goes on with what has piled up",
        _half_open,
        shared=True,
    ),
    Fault(
        "freeze",
        "the chassis's program hangs: its time stands still, requests are read but neither done "
        "nor answered, WebSocket pings are answered; afterwards it does what has piled up",
        _freeze,
        shared=True,
    ),
)
