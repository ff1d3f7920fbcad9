"""The agents of one process: one agent, or one for each robot in the parameter `robots`.

They share the process, the rclpy context, the executor and the thread of the links.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rclpy.exceptions import InvalidNamespaceException, ParameterException
from rclpy.validate_namespace import validate_namespace

from woosh_robot_agent.parameters import Settings
from woosh_robot_agent.program import descriptor_problem
from woosh_robot_agent.ros.bridge import LoopThread
from woosh_robot_agent.ros.node import Agent, ParameterNode, stop_all
from woosh_robot_agent.ros.releases import error_text

_STOP_TIMEOUT = 0.3
"""Timeout for the end of the link thread, in seconds."""


class Fleet:
    """The agents of this process, as configured by its arguments and parameter files.

    Args:
        stopping: returns True once the program is about to end. From then on, no further agents are
            created, because creating 20 of them takes several seconds.
        options: rclpy's options of the nodes, e.g. `context`.

    Attributes:
        agents: one for each robot; at least one.

    Raises:
        ValueError: a parameter is invalid; the text names the robot and says what to do.
    """

    def __init__(self, stopping: Callable[[], bool] = lambda: False, **options: Any) -> None:
        nodes = _create_nodes(options, stopping)
        self._thread = LoopThread()
        self.agents = [Agent(nodes.pop(0), self._thread)]
        while nodes and not stopping():
            self.agents.append(Agent(nodes.pop(0), self._thread))
        for node in nodes:
            node.destroy_node()

    def begin_close_on(self, fd: int) -> None:
        """Begin to close all agents when a file descriptor becomes readable, e.g. by a signal.

        The Ctrl-C that ends the agents may also end a simulated chassis. The agents close their
        links at once, before they would report the links as lost.
        """
        loop = self._thread.loop

        def begin() -> None:
            loop.remove_reader(fd)
            for agent in self.agents:
                agent.begin_close()
            executor = self.agents[0].node.executor
            if executor is not None:
                executor.create_task(lambda: None)  # an empty task, which ends the executor's wait

        loop.call_soon_threadsafe(loop.add_reader, fd, begin)

    def close(self, spin_once: Callable[[], None], *, destroy: bool = True) -> None:
        """Stop all robots, abort all goals and close all links, at the same time.

        Args:
            spin_once: runs one executor turn, so that goal results reach their clients.
            destroy: also destroy the nodes. With many robots, that takes long.
        """
        stop_all(self.agents, spin_once)
        if destroy:
            for agent in self.agents:
                agent.destroy()
        self._thread.stop(_STOP_TIMEOUT)


def namespaces(names: Sequence[str], own: str) -> dict[str, str]:
    """Return the absolute namespace of each robot, by the robot's name.

    Args:
        names: names of the robots; relative names are resolved in the namespace `own`.
        own: namespace of the program.

    Raises:
        ValueError: a name is invalid, or two robots have the same namespace.
    """
    by_name: dict[str, str] = {}
    for name in names:
        namespace = name if name.startswith("/") else f"{own.rstrip('/')}/{name}"
        try:
            validate_namespace(namespace)
        except InvalidNamespaceException as error:
            raise ValueError(
                f"robots: {name!r} is not a namespace; use letters, digits, underscores and "
                f"slashes, e.g. robots: [r1, /hall/r2] ({error})"
            ) from error
        if namespace in by_name.values():
            raise ValueError(f"robots: give each robot its own name; two have {namespace}")
        by_name[name] = namespace
    return by_name


def _create_nodes(options: dict[str, Any], stopping: Callable[[], bool]) -> list[ParameterNode]:
    """Create a node for each robot, which has only its parameters at first.

    Args:
        stopping: returns True once the program has to end. From then on, no node is created,
            except the first one, because there must be at least one agent.

    Raises:
        ValueError: there are too many robots, or a parameter is invalid.
    """
    first = ParameterNode(**options)
    robots = first.settings.robots
    if not robots:
        return [first]
    own = first.get_namespace()
    first.destroy_node()  # this node was needed only to read the parameter `robots`
    if problem := descriptor_problem(len(robots)):
        raise ValueError(problem)
    nodes: list[ParameterNode] = []
    try:
        for name, namespace in namespaces(robots, own).items():
            if not nodes or not stopping():
                nodes.append(_create_node(name, namespace, options))
        _check_compatible(nodes)
    except BaseException:
        for node in nodes:
            node.destroy_node()
        raise
    return nodes


def _create_node(name: str, namespace: str, options: dict[str, Any]) -> ParameterNode:
    """Create the node of a robot; raise ValueError with the cause if a parameter is invalid."""
    prefix = name.strip("/")
    defaults = {
        "ip": "",  # invalid, so it must be set: several robots cannot all have the default address
        "frame_prefix": f"{prefix}/" if prefix else "",  # because all robots share /tf
    }
    try:
        # a node's own remapping overrides the program's
        return ParameterNode(
            defaults, cli_args=["--ros-args", "-r", f"__ns:={namespace}"], **options
        )
    except (ValueError, ParameterException) as error:
        raise ValueError(
            f"robot {namespace}: {error_text(error)} (set its parameters under {namespace}/agent "
            "in the parameter file)"
        ) from error


def _check_compatible(nodes: Sequence[ParameterNode]) -> None:
    """Check parameters that are valid for each robot alone but not together in one process.

    Raises:
        ValueError: two robots have the same address. Their `robot_id` does not tell them apart,
            because velocities and cancels carry none.
    """
    for one, other in _duplicates(nodes, lambda s: (s.link.ip, s.link.effective_port)):
        raise ValueError(
            f"robots {one.get_namespace()} and {other.get_namespace()} have the same address "
            f"({other.settings.link.address}); give each its own ip or port in the parameter file"
        )
    for one, other in _duplicates(nodes, lambda s: s.standard.frame_prefix):
        other.get_logger().warning(
            f"frame_prefix is the same as that of {one.get_namespace()}, so their frames on /tf "
            "collide; give each robot its own prefix, or remap /tf: "
            f"{other.settings.standard.frame_prefix!r}"
        )


def _duplicates(
    nodes: Sequence[ParameterNode], key: Callable[[Settings], Any]
) -> Iterator[tuple[ParameterNode, ParameterNode]]:
    """Yield pairs of robots with the same key: the first robot that has it and each later one."""
    first: dict[Any, ParameterNode] = {}
    for node in nodes:
        known = first.setdefault(key(node.settings), node)
        if known is not node:
            yield known, node
