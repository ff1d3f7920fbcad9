"""Faults of the connection as a whole."""

from __future__ import annotations

from woosh_robot_agent.simulator.faults.arguments import Argument
from woosh_robot_agent.simulator.faults.fault import End, Fault, Injection, Target


def _drop(target: Target, injection: Injection) -> None:
    target.drop()


def _accept_then_drop(target: Target, injection: Injection) -> End:
    def refuse_connection() -> bool:
        injection.hit()
        return False

    return target.hooks.add_admission(refuse_connection)


def _off(target: Target, injection: Injection) -> End:
    target.set_listening(False)
    return lambda: target.set_listening(True)


def _half_open(target: Target, injection: Injection) -> End:
    target.pause_connections(True)
    return lambda: target.pause_connections(False)


def _freeze(target: Target, injection: Injection) -> End:
    target.freeze(True)
    return lambda: target.freeze(False)


FAULTS = (
    Fault("drop", "every connection ends, as with a broken cable", _drop, lasting=False),
    Fault(
        "accept_then_drop",
        "each new connection is accepted and closed at once, a WebSocket after its handshake",
        _accept_then_drop,
        (Argument("count", int, 0, "number of connections; 0: all", low=0),),
    ),
    Fault(
        "off",
        "every connection ends and new ones are refused, as if the robot were switched off; at "
        "the end it listens on the same ports again",
        _off,
        shared=True,
    ),
    Fault(
        "half_open",
        "nothing is read or written, but the sockets stay open, and new connections are accepted; "
        "at the end everything pending is read and written",
        _half_open,
        shared=True,
    ),
    Fault(
        "freeze",
        "the program of the robot hangs: simulated time stands still, requests are read but not "
        "executed, WebSocket pings are answered; at the end all pending requests are executed",
        _freeze,
        shared=True,
    ),
)
