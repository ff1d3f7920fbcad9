"""SROS2 policies of the agent and of its clients, generated from the table of endpoints.

`python3 -m scripts.sros2_policies agent` prints the policy of the agent, which allows exactly
its own endpoints. `python3 -m scripts.sros2_policies client` prints the policy of a client,
which allows all of them, or a part with `--read-only` and `--only`. `scripts/make_keystore` makes a
keystore with both.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from woosh_robot_agent.endpoints import ACTIONS, AGENT_INFO, COMMANDS, NAMESPACE, QUERIES, TOPICS
from woosh_robot_agent.ros.standard_endpoints import NAV2, STANDARD, Kind

CLIENT_NODE = "/client"
"""Default name of the client's node."""

_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_NODE_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
"""Services of every rclpy node."""
_NODE_TOPICS = ("/rosout", "/parameter_events")
"""Topics that every rclpy node publishes."""


def _standard_names(*kinds: Kind) -> list[str]:
    return [each.name for each in (*STANDARD, *NAV2) if each.kind in kinds]


_OUTPUTS = [each.name for each in (*TOPICS, AGENT_INFO)]
_OUTPUTS += _standard_names(Kind.STREAM, Kind.LATCHED)
_INPUTS = _standard_names(Kind.INPUT)
_OWN_INPUTS = ("/tf", "/tf_static")
"""Topics that the agent subscribes to, for goals of Nav2's actions in other frames than its own."""
_QUERIES = [each.name for each in QUERIES] + [each.name for each in COMMANDS if each.reads]
_QUERIES += _standard_names(Kind.READING_SERVICE)
_COMMANDS = [each.name for each in COMMANDS if not each.reads]
_COMMANDS += _standard_names(Kind.SERVICE)
_ACTIONS = [each.name for each in ACTIONS] + _standard_names(Kind.ACTION)


def agent_policy(namespace: str = NAMESPACE, *, sim_time: bool = False) -> str:
    """Return the policy of the agent with all its parts enabled, for the enclave NAMESPACE/agent.

    Args:
        namespace: namespace of the agent; `/` for none.
        sim_time: True if the agent runs with `use_sim_time` and so subscribes to /clock.

    Raises:
        ValueError: `namespace` is not an absolute ROS name.
    """
    prefix = _prefix(namespace)
    profile = _Profile(f"{prefix}/agent", sim_time=sim_time)
    services = _QUERIES + _COMMANDS
    profile.allow("topics", "publish", (_absolute(prefix, name) for name in _OUTPUTS))
    profile.allow(
        "topics", "subscribe", (_absolute(prefix, name) for name in (*_INPUTS, *_OWN_INPUTS))
    )
    profile.allow("services", "reply", (_absolute(prefix, name) for name in services))
    profile.allow("actions", "execute", (_absolute(prefix, name) for name in _ACTIONS))
    return profile.policy(f"{prefix}/agent")


def client_policy(
    namespace: str = NAMESPACE,
    node: str = CLIENT_NODE,
    *,
    read_only: bool = False,
    only: Sequence[str] = (),
    sim_time: bool = False,
) -> str:
    """Return the policy of a client, for the enclave NAMESPACE/NODE.

    It does not allow the client to set the agent's parameters, because they select the robot.

    Args:
        namespace: namespace of the agent; `/` for none.
        node: full name of the client's node.
        read_only: True to allow topics and queries, but no commands and no actions.
        only: patterns of the endpoints to allow, e.g. `robot/Pose*`; by default all.
        sim_time: True if the client runs with `use_sim_time` and so subscribes to /clock.

    Raises:
        ValueError: a name is not an absolute ROS name, a pattern matches no endpoint, or with
            `read_only` the patterns match commands and actions only.
    """
    prefix = _prefix(namespace)
    names = {*_QUERIES, *_COMMANDS, *_OUTPUTS, *_INPUTS, *_ACTIONS}
    for pattern in only:
        if not _matching(names, [pattern]):
            raise ValueError(
                f"no endpoint matches; docs/endpoints.md lists their names: {pattern!r}"
            )
    if read_only and only and not _matching((*_OUTPUTS, *_QUERIES), only):
        raise ValueError(
            "only commands and actions match, which --read-only excludes; drop --read-only or "
            f"change --only: {', '.join(map(repr, only))}"
        )

    def selected(endpoints: Iterable[str]) -> list[str]:
        return [_absolute(prefix, name) for name in _matching(endpoints, only or ("*",))]

    profile = _Profile(_check_name(node), sim_time=sim_time)
    profile.allow("topics", "subscribe", selected(_OUTPUTS))
    services = _QUERIES if read_only else _QUERIES + _COMMANDS
    profile.allow("services", "request", selected(services))
    if not read_only:
        profile.allow("topics", "publish", selected(_INPUTS))
        profile.allow("actions", "call", selected(_ACTIONS))
    return profile.policy(f"{prefix}{node}")


class _Profile:
    """Permissions of one node, beginning with those that every rclpy node needs."""

    def __init__(self, node: str, *, sim_time: bool) -> None:
        namespace, _, name = node.rpartition("/")
        self._element = Element("profile", ns=namespace or "/", node=name)
        self.allow("topics", "publish", _NODE_TOPICS)
        if sim_time:
            self.allow("topics", "subscribe", ["/clock"])
        self.allow("services", "reply", (f"{node}/{service}" for service in _NODE_SERVICES))

    def allow(self, kind: str, operation: str, names: Iterable[str]) -> None:
        """Allow an operation.

        Args:
            kind: `topics`, `services` or `actions`.
            operation: operation of that kind, e.g. `publish`.
            names: full names of the topics, services or actions.
        """
        group = Element(kind, {operation: "ALLOW"})
        for name in sorted(names):
            SubElement(group, kind.removesuffix("s")).text = name
        if len(group):
            self._element.append(group)

    def policy(self, enclave: str) -> str:
        """Return a policy file with this profile as the only one of `enclave`."""
        root = Element("policy", version="0.2.0")
        parent = SubElement(SubElement(root, "enclaves"), "enclave", path=enclave)
        SubElement(parent, "profiles").append(self._element)
        indent(root)
        return f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, encoding="unicode")}\n'


def _matching(names: Iterable[str], patterns: Sequence[str]) -> list[str]:
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)]


def _absolute(prefix: str, name: str) -> str:
    """Return the absolute form of an endpoint's name."""
    return name if name.startswith("/") else f"{prefix}/{name}"


def _prefix(namespace: str) -> str:
    """Return what precedes the slash before a name in `namespace`."""
    return "" if namespace == "/" else _check_name(namespace)


def _check_name(name: str) -> str:
    """Return `name`; raise ValueError unless it is an absolute ROS name."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"not an absolute ROS name such as {NAMESPACE}: {name!r}")
    return name


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a policy.

    Args:
        arguments: arguments of the program; by default those of the command line.

    Returns:
        The exit status.
    """
    parser = argparse.ArgumentParser(
        prog="python3 -m scripts.sros2_policies",
        description="Print the SROS2 policy of the agent or of a client.",
    )
    parser.add_argument("whose", choices=("agent", "client"), help="whose policy to print")
    parser.add_argument(
        "--namespace", default=NAMESPACE, help="namespace of the agent (default: %(default)s)"
    )
    parser.add_argument("--sim-time", action="store_true", help="the node runs with use_sim_time")
    clients = parser.add_argument_group("options for a client")
    clients.add_argument(
        "--node", default=CLIENT_NODE, help="full name of the client's node (default: %(default)s)"
    )
    clients.add_argument(
        "--read-only", action="store_true", help="allow no commands and no actions"
    )
    clients.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="PATTERN",
        help="allow only endpoints that match, e.g. robot/Pose*; can be repeated (default: all)",
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
