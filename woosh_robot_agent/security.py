"""SROS2 policies of the agent and of its clients, made from the table of endpoints.

`python3 -m woosh_robot_agent.security agent` prints the agent's, which allows exactly what it has;
`... client` that of a node which uses all of it, or with `--read-only` and `--only` a part.
`scripts/make_keystore` makes a keystore of the two in `config/`.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, NAMESPACE, QUERIES, TOPICS
from woosh_robot_agent.standard.endpoints import STANDARD, Kind

CLIENT_NODE = "/client"

_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_OF_EVERY_NODE = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
"""Services that rclpy gives a node."""
_PUBLISHED_BY_EVERY_NODE = ("/rosout", "/parameter_events")
_OUTPUTS = [each.name for each in TOPICS] + [each.name for each in STANDARD if each.is_output]
_INPUTS = [each.name for each in STANDARD if each.kind is Kind.INPUT]
_ASKING = [each.name for each in QUERIES]
_COMMANDING = [each.name for each in COMMANDS]
_COMMANDING += [each.name for each in STANDARD if each.kind is Kind.SERVICE]
_OWN_GOALS = ("ros/MoveBase",)
"""Actions that the agent is a client of itself: goal_pose becomes a goal."""


def agent_policy(namespace: str = NAMESPACE, *, sim_time: bool = False) -> str:
    """The policy of the agent with every part switched on, for the enclave NAMESPACE/agent.

    Args:
        namespace: the namespace that the agent runs in, `/` for none.
        sim_time: whether it runs with `use_sim_time`, and so listens to /clock.

    Raises:
        ValueError: `namespace` is no absolute ROS name.
    """
    here = _prefix(namespace)
    profile = _Profile(f"{here}/agent", sim_time=sim_time)
    services = _ASKING + _COMMANDING
    profile.allow("topics", "publish", (_path(here, name) for name in _OUTPUTS))
    profile.allow("topics", "subscribe", (_path(here, name) for name in _INPUTS))
    profile.allow("services", "reply", (_path(here, name) for name in services))
    profile.allow("actions", "execute", (_path(here, each.name) for each in ACTIONS))
    profile.allow("actions", "call", (_path(here, name) for name in _OWN_GOALS))
    return profile.policy(f"{here}/agent")


def client_policy(
    namespace: str = NAMESPACE,
    node: str = CLIENT_NODE,
    *,
    read_only: bool = False,
    only: Sequence[str] = (),
    sim_time: bool = False,
) -> str:
    """The policy of a node that uses the agent, for the enclave NAMESPACE/NODE.

    It may not set the agent's parameters: who does that can have it drive another robot.

    Args:
        namespace: the namespace that the agent runs in, `/` for none.
        node: full name of the client's node.
        read_only: allow topics and queries, but nothing that has the robot do something.
        only: patterns of endpoint names, such as `robot/Pose*`; others are left out.
        sim_time: whether it runs with `use_sim_time`, and so listens to /clock.

    Raises:
        ValueError: a name is no absolute ROS name, or a pattern fits no endpoint; or with
            `read_only` the patterns together fit none that is only read.
    """
    here = _prefix(namespace)
    names = {each.name for each in (*QUERIES, *COMMANDS, *TOPICS, *ACTIONS, *STANDARD)}
    for pattern in only:
        if not _fitting(names, [pattern]):
            raise ValueError(f"no endpoint is called {pattern!r}; the README has their names")
    if read_only and only and not _fitting((*_OUTPUTS, *_ASKING), only):
        raise ValueError(
            f"nothing that is only read is called {' or '.join(map(repr, only))}: these are "
            "commands, which --read-only leaves out; leave one of the two away"
        )

    def full(endpoints: Iterable[str]) -> list[str]:
        return [_path(here, name) for name in _fitting(endpoints, only or ("*",))]

    profile = _Profile(_checked(node), sim_time=sim_time)
    profile.allow("topics", "subscribe", full(_OUTPUTS))
    services = _ASKING if read_only else _ASKING + _COMMANDING
    profile.allow("services", "request", full(services))
    if not read_only:
        profile.allow("topics", "publish", full(_INPUTS))
        profile.allow("actions", "call", full(action.name for action in ACTIONS))
    return profile.policy(f"{here}{node}")


class _Profile:
    """What one node may do, beginning with what every node of rclpy does."""

    def __init__(self, node: str, *, sim_time: bool) -> None:
        namespace, _, name = node.rpartition("/")
        self._element = Element("profile", ns=namespace or "/", node=name)
        self.allow("topics", "publish", _PUBLISHED_BY_EVERY_NODE)
        if sim_time:
            self.allow("topics", "subscribe", ["/clock"])
        self.allow("services", "reply", (f"{node}/{service}" for service in _OF_EVERY_NODE))

    def allow(self, kind: str, deed: str, names: Iterable[str]) -> None:
        """Allow a deed on topics, services or actions of these names."""
        group = Element(kind, {deed: "ALLOW"})
        for name in sorted(names):
            SubElement(group, kind.removesuffix("s")).text = name
        if len(group):
            self._element.append(group)

    def policy(self, enclave: str) -> str:
        """The whole file, with this profile alone in `enclave`."""
        root = Element("policy", version="0.2.0")
        parent = SubElement(SubElement(root, "enclaves"), "enclave", path=enclave)
        SubElement(parent, "profiles").append(self._element)
        indent(root)
        return f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, encoding="unicode")}\n'


def _fitting(names: Iterable[str], patterns: Sequence[str]) -> list[str]:
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)]


def _path(here: str, name: str) -> str:
    """A name of a table as an absolute one."""
    return name if name.startswith("/") else f"{here}/{name}"


def _prefix(namespace: str) -> str:
    """What stands before the slash of a name in `namespace`."""
    return "" if namespace == "/" else _checked(namespace)


def _checked(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is no absolute ROS name, such as {NAMESPACE}")
    return name


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a policy. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python3 -m woosh_robot_agent.security",
        description="Print the SROS2 policy of the agent or of a client.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("whose", choices=("agent", "client"))
    parser.add_argument("--namespace", default=NAMESPACE, help="namespace that the agent runs in")
    parser.add_argument("--sim-time", action="store_true", help="it runs with use_sim_time")
    clients = parser.add_argument_group("of a client")
    clients.add_argument("--node", default=CLIENT_NODE, help="full name of its node")
    clients.add_argument("--read-only", action="store_true", help="topics and queries, no commands")
    clients.add_argument(
        "--only", action="append", default=[], metavar="PATTERN", help="endpoints, e.g. robot/Pose*"
    )
    options = parser.parse_args(arguments)
    try:
        if options.whose == "agent":
            print(agent_policy(options.namespace, sim_time=options.sim_time), end="")
        else:
            print(
                client_policy(
                    options.namespace,
                    options.node,
                    read_only=options.read_only,
                    only=options.only,
                    sim_time=options.sim_time,
                ),
                end="",
            )
    except ValueError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
