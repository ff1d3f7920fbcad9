"""The agents of one process: one, or one for each name in the parameter `robots`.

They share the process, one rclpy context, one executor and one event loop for their links.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rclpy.exceptions import InvalidNamespaceException, ParameterException
from rclpy.validate_namespace import validate_namespace

from woosh_robot_agent.bridge import LoopThread
from woosh_robot_agent.node import Agent, close_all
from woosh_robot_agent.parameter_node import ParameterNode
from woosh_robot_agent.parameters import Settings

_STOP_TIMEOUT = 0.3
"""s in which the thread of the links must end."""


class Fleet:
    """The agents of this process, as its arguments and parameter files want them.

    Args:
        options: rclpy's options of the nodes, e.g. `context`.

    Attributes:
        agents: one for each robot.
        executor: the executor that their parameters ask for.

    Raises:
        ValueError: a parameter makes no sense; the text says which robot's, and what to do.
    """

    def __init__(self, **options: Any) -> None:
        nodes = _nodes(options)
        self.executor = nodes[0].settings.executor
        self._thread = LoopThread()
        self.agents = [Agent(node, self._thread) for node in nodes]

    def begin_close_on(self, fd: int) -> None:
        """Begin to close all agents when a file descriptor becomes readable.

        A chassis may end at the same moment, by the same Ctrl-C as a simulator does. The agents
        close their links before they could take that for a loss.
        """
        loop = self._thread.loop

        def begin() -> None:
            loop.remove_reader(fd)
            for agent in self.agents:
                agent.begin_close()

        loop.call_soon_threadsafe(loop.add_reader, fd, begin)

    def close(self, spin_once: Callable[[], None]) -> None:
        """End all of them at a time; see `Agent.close`."""
        close_all(self.agents, spin_once)
        self._thread.stop(_STOP_TIMEOUT)


def namespaces(names: Sequence[str], own: str) -> dict[str, str]:
    """The namespace of each robot by its name.

    Args:
        names: the names; a relative one is below `own`, an absolute one is taken as it is.
        own: the namespace of the program.

    Raises:
        ValueError: a name is none, or two are the same.
    """
    found: dict[str, str] = {}
    for name in names:
        namespace = name if name.startswith("/") else f"{own.rstrip('/')}/{name}"
        try:
            validate_namespace(namespace)
        except InvalidNamespaceException as error:
            raise ValueError(
                f"robots: {name!r} is no namespace: letters, digits, underscores and slashes make "
                f"one, e.g. robots: [r1, /hall/r2] ({error})"
            ) from error
        if namespace in found.values():
            raise ValueError(f"robots: {namespace} is there twice: each robot needs its own name")
        found[name] = namespace
    return found


def _nodes(options: dict[str, Any]) -> list[ParameterNode]:
    """A node for each robot, none of which does anything yet."""
    first = ParameterNode(**options)
    robots = first.settings.robots
    if not robots:
        return [first]
    own = first.get_namespace()
    first.destroy_node()  # it has told which nodes there are to be
    nodes: list[ParameterNode] = []
    try:
        for name, namespace in namespaces(robots, own).items():
            nodes.append(_node(name, namespace, options))
        _check_together(nodes)
    except BaseException:
        for node in nodes:
            node.destroy_node()
        raise
    return nodes


def _node(name: str, namespace: str, options: dict[str, Any]) -> ParameterNode:
    frames = name.strip("/")
    defaults = {
        "ip": "",  # no address is every robot's
        "frame_prefix": f"{frames}/" if frames else "",  # /tf is for all of them
    }
    try:
        # a remapping of the node's own counts for more than one that was given to the program
        return ParameterNode(
            defaults, cli_args=["--ros-args", "-r", f"__ns:={namespace}"], **options
        )
    except (ValueError, ParameterException) as error:
        raise ValueError(
            f"robot {namespace}: {error} (its own parameters are those of {namespace}/agent in the "
            "parameter file)"
        ) from error


def _check_together(nodes: Sequence[ParameterNode]) -> None:
    """What makes sense for each robot alone, and not for several in one process."""
    for one, other in _alike(nodes, lambda s: (s.link.ip, s.link.effective_port, s.link.robot_id)):
        raise ValueError(
            f"robots {one.get_namespace()} and {other.get_namespace()} are the same one, at "
            f"{other.settings.link.address}: give each an ip of its own, or a port or robot_id, "
            "in the parameter file"
        )
    if len({node.settings.executor for node in nodes}) > 1:
        raise ValueError("executor differs: robots of one process share it, so set it under /**")
    for one, other in _alike(nodes, lambda s: s.standard.frame_prefix):
        other.get_logger().warning(
            f"frame_prefix {other.settings.standard.frame_prefix!r} is also that of "
            f"{one.get_namespace()}: on /tf nobody can tell their frames apart; give each its own, "
            "or remap /tf"
        )


def _alike(
    nodes: Sequence[ParameterNode], what: Callable[[Settings], Any]
) -> Iterator[tuple[ParameterNode, ParameterNode]]:
    """Each robot that has the same of something as one before, with that one."""
    first: dict[Any, ParameterNode] = {}
    for node in nodes:
        known = first.setdefault(what(node.settings), node)
        if known is not node:
            yield known, node
