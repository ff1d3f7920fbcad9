"""A ROS domain of a test's own, on this machine only."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator, Mapping

_LOCK_PORT = 21000
"""Bound on the loopback while a domain is in use: what other processes on this machine see."""
_DOMAINS = 100
_started = iter(range(10_000_000))


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine uses now, on the loopback only.

    It is in the environment meanwhile: what calls `rclpy.init()` or starts a process is in it.

    Raises:
        RuntimeError: a hundred tests run at this moment.
    """
    start = (os.getpid() * 17 + next(_started)) % _DOMAINS
    for offset in range(_DOMAINS):
        domain = 1 + (start + offset) % _DOMAINS
        with socket.socket() as lock:
            try:
                lock.bind(("127.0.0.1", _LOCK_PORT + domain))
            except OSError:
                continue
            with _environment(domain_variables(domain)):
                yield domain
            return
    raise RuntimeError(f"all {_DOMAINS} domains for tests are in use on this machine")


def domain_variables(domain: int) -> dict[str, str]:
    """The environment that puts a process into a domain, on the loopback only."""
    return {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@contextlib.contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
