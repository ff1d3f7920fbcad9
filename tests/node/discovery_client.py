"""Nodes that look for the agent, run as a process: discovery_client.py ROLE DOMAIN.

It prints what they find. A process in which a node has used a discovery server cannot have nodes
without one afterwards, so the tests do not use one in their own process.
"""

from __future__ import annotations

import subprocess
import sys

from tests.harness import NAMESPACE, Client, wait_until
from woosh_robot_msgs.srv import Setting

USED = f"{NAMESPACE}/robot/Setting"
OTHER = f"{NAMESPACE}/robot/PoseSpeed"


def use(domain: int) -> None:
    """Call a service; print the name of the robot, and how many services it sees besides."""
    client = Client(domain)
    client.service(Setting, "robot/Setting")
    # `service` could not do this: the server hides agent/get_parameters, which is not used here
    client.wait_known(Setting, USED)
    print(client.call(Setting, "robot/Setting").info.identity.name)
    print(client.node.count_services(OTHER))
    client.close()


def look_for_later_node(domain: int) -> None:
    """Print the number of services seen, once a node that started after this one is seen."""
    client = Client(domain)
    later = subprocess.Popen(
        [sys.executable, "-m", "tests.node.discovery_client", "stay", str(domain)],
        stdin=subprocess.PIPE,
    )
    wait_until(lambda: "later" in client.node.get_node_names(), "the later node")
    print(client.node.count_services(USED))
    client.close()
    later.communicate()


def stay(domain: int) -> None:
    """Run a node until stdin is closed."""
    client = Client(domain, name="later")
    sys.stdin.read()
    client.close()


if __name__ == "__main__":
    roles = {function.__name__: function for function in (use, look_for_later_node, stay)}
    roles[sys.argv[1]](int(sys.argv[2]))
