"""Start the agent and a chassis for a measurement."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from benchmarks.options import Options
from benchmarks.processes import Program, running
from woosh_robot_agent.testing.agents import NAMESPACE

FLOOR = "/floor"
"""Namespace of a floor that shares a ROS domain with the agent."""


@contextlib.contextmanager
def chassis_running(
    name: str, domain: int, transport: str, *options: str
) -> Iterator[tuple[Program, int]]:
    """Run a chassis of this folder; yield the program and its port."""
    command = (f"benchmarks.programs.{name}", "--transport", transport, *options)
    with running(*command, domain=domain) as program:
        yield program, program.receive()


@contextlib.contextmanager
def two_chassis(
    name: str, domain: int, transport: str
) -> Iterator[tuple[tuple[Program, int], tuple[Program, int]]]:
    """Run a chassis for the agent and one for a floor, which needs a WebSocket.

    If the agent uses a WebSocket, too, both have the same chassis.
    """
    with contextlib.ExitStack() as stack:
        ours = floor = stack.enter_context(chassis_running(name, domain, transport))
        if transport != "websocket":
            floor = stack.enter_context(chassis_running(name, domain, "websocket"))
        yield ours, floor


echo_chassis = partial(chassis_running, "echo_chassis")
"""Runs the echo chassis; see `chassis_running`."""


@contextlib.contextmanager
def bare_program(name: str, domain: int, port: int) -> Iterator[Program]:
    """Run a floor that connects to the chassis at `port`; the block starts when it has."""
    url = f"ws://127.0.0.1:{port}"
    with running(f"benchmarks.floors.{name}", url, domain=domain) as program:
        program.wait_logged("connected to")
        yield program


@contextlib.contextmanager
def agent(
    domain: int, port: int, options: Options, namespace: str = NAMESPACE, **parameters: Any
) -> Iterator[Program]:
    """Run the agent; the block starts when it is connected to the chassis at `port`."""
    with running(*agent_command(port, options, namespace, **parameters), domain=domain) as program:
        program.wait_logged("connected to")
        yield program


def agent_command(
    port: int, options: Options, namespace: str = NAMESPACE, **parameters: Any
) -> list[str]:
    """Return the agent's module and arguments, as `running` takes them."""
    values: Mapping[str, Any] = {
        "ip": "127.0.0.1",
        "port": port,
        **options.agent_parameters,
        **parameters,
    }
    words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    return ["woosh_robot_agent.agent", "--ros-args", "-r", f"__ns:={namespace}", *words]
