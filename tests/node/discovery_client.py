"""Nodes that look for the agent, run as a process: discovery_client.py ROLE DOMAIN.

It prints what they find. A process in which a node has used a discovery server cannot have nodes
without one afterwards, so the tests do not use one in their own process.
"""

from __future__ import annotations

import sys

from tests.harness import NAMESPACE, Client, wait_until
from woosh_robot_msgs.srv import Setting

USED = f"{NAMESPACE}/robot/Setting"
OTHER = f"{NAMESPACE}/robot/PoseSpeed"


def use(domain: int) -> None:
    """Call a service; print the name of the robot, and how many services it sees besides."""
    client = Client(domain)
    print(client.call(Setting, "robot/Setting").info.identity.name)
    print(client.node.count_services(OTHER))
    client.close()


def look(domain: int) -> None:
    """Print the number of services seen, without using them."""
    client = Client(domain)
    wait_until(lambda: client.node.count_services(OTHER), "the service")
    print(client.node.count_services(OTHER))
    client.close()


def look_after_other_nodes(domain: int) -> None:
    """Print the number of services seen, once two nodes of this process see each other.

    By then they would have found the agent, too.
    """
    one, other = Client(domain, name="one"), Client(domain, name="other")
    wait_until(lambda: "other" in one.node.get_node_names(), "the other node")
    print(one.node.count_services(USED))
    one.close()
    other.close()


if __name__ == "__main__":
    {"use": use, "look": look, "look_after_other_nodes": look_after_other_nodes}[sys.argv[1]](
        int(sys.argv[2])
    )
