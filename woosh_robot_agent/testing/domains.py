"""ROS domains for tests, each used by one test at a time."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
from collections.abc import Iterator, Mapping

from woosh_robot_agent.ros_release import this_computer_only

_LOCK_PORT = 21000
"""Base of the TCP ports that lock a domain for all processes of this machine.

Domain N is in use while the port with this number plus N is bound.
"""
_DOMAINS = 100
"""Number of domains for tests, from 1."""
_counter = itertools.count()
_locks: dict[int, socket.socket] = {}
"""Sockets that are bound to the port of each domain which this process uses."""


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """Yield a ROS_DOMAIN_ID that no other test on this machine uses, limited to this machine.

    The environment variables are set meanwhile, so `rclpy.init()` and child processes use it.

    Raises:
        RuntimeError: All domains for tests are in use.
    """
    start = (os.getpid() * 17 + next(_counter)) % _DOMAINS
    for offset in range(_DOMAINS):
        domain = 1 + (start + offset) % _DOMAINS
        with socket.socket() as lock:
            try:
                lock.bind(("127.0.0.1", _LOCK_PORT + domain))
            except OSError:
                continue
            _locks[domain] = lock
            try:
                with _environment(domain_variables(domain)):
                    yield domain
            finally:
                del _locks[domain]
            return
    raise RuntimeError(f"all {_DOMAINS} ROS domains for tests are in use on this machine")


def inherited_lock(domain: int) -> tuple[int, ...]:
    """Return the file descriptors that a child process in a domain must inherit.

    They keep the domain in use for as long as the process runs, even if the test is killed.
    """
    return (_locks[domain].fileno(),) if domain in _locks else ()


def domain_variables(domain: int) -> dict[str, str]:
    """Return the environment variables of a process in a domain, limited to this machine."""
    return {"ROS_DOMAIN_ID": str(domain), **this_computer_only()}


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
