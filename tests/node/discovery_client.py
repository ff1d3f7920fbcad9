"""A node that uses the agent, run as a process: discovery_client.py DOMAIN.

It prints what it finds. A process in which a node has used a discovery server cannot have nodes
without one afterwards, so the test does not use one in its own process.
"""

from __future__ import annotations

import sys

from tests.harness import NAMESPACE, Client
from woosh_robot_msgs.srv import Setting


def main(domain: int) -> None:
    """Call a service; print the name of the robot, and how many other services it sees."""
    client = Client(domain)
    client.service(Setting, "robot/Setting")
    # `service` could not do this: the server hides agent/get_parameters, which is not used here
    client.wait_known(Setting, f"{NAMESPACE}/robot/Setting")
    print(client.call(Setting, "robot/Setting").info.identity.name)
    print(client.node.count_services(f"{NAMESPACE}/robot/PoseSpeed"))
    client.close()


if __name__ == "__main__":
    main(int(sys.argv[1]))
