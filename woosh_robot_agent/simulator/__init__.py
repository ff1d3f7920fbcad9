"""A chassis on your laptop: the other end of the link, as a program and as a library.

`python -m woosh_robot_agent.simulator` runs it; no ROS is needed. In a test:

    with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=20)) as simulator:
        ...  # connect to ws://127.0.0.1:{simulator.port}

The model (`chassis` and what it imports) is pure: it is stepped in simulated time and knows neither
sockets nor asyncio. `dispatch` maps each request to its handler, `exchange` holds the conversation
with the clients, `server` puts that on ports, `faults` is what can go wrong with it all.
"""

import woosh_robot_agent.protos  # noqa: F401 - says what to do where nothing is compiled yet
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults import FaultError, Injection, Scenario, load_scenario
from woosh_robot_agent.simulator.server import SimulatedChassis
from woosh_robot_agent.simulator.serving.exchange import Received
from woosh_robot_agent.simulator.serving.hooks import Interceptor, Outgoing
from woosh_robot_agent.simulator.snapshot import Snapshot
from woosh_robot_agent.simulator.thread import SimulatorThread

__all__ = [
    "FaultError",
    "Injection",
    "Interceptor",
    "Outgoing",
    "Received",
    "Scenario",
    "SimulatedChassis",
    "SimulatorConfig",
    "SimulatorThread",
    "Snapshot",
    "load_scenario",
]
