"""A simulated chassis, which agents connect to like a real one, as a program and as a library.

`python3 -m woosh_robot_agent.simulator` runs it. It does not need ROS. In a test:

    with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=20)) as simulator:
        ...  # connect to ws://127.0.0.1:{simulator.port}

The packages and modules; each imports only packages and modules above it in this list:

- `timeline`: simulated time, and calls that are due later. `status_codes`: codes that the robot
  reports. `refusals`: reasons why the robot refuses a request.
- `profile`: how a robot of some model behaves, read from a file. `config`: the options.
- `world`: geometry, maps, obstacles, collisions, laser and path planner.
- `body`: the parts of the robot. `scenes`: maps with marks and tasks, read from files.
- `robot`: the robot made of these, without behaviour.
- `behaviour`: what the robot does over time, as jobs. `behaviour.ownership` decides which job owns
  which device.
- `chassis`: the robot with its behaviour. It has no sockets and no clock: simulated time is
  advanced step by step.
- `protocol`: requests, reports and pushes.
- `serving`: clients and connections.
- `faults`: faults of the robot and the link that can be injected, e.g. lost answers.
- `scene_check`: finds errors in the files of a scene.
- `server`, `thread`, `command_line`: the simulated chassis in an event loop, in a thread, as a
  program.
"""

import importlib

TYPE_CHECKING = False  # type checkers take it as True; so `typing` need not be imported
if TYPE_CHECKING:
    from woosh_robot_agent.simulator.config import SimulatorConfig
    from woosh_robot_agent.simulator.faults import FaultError, Injection, Scenario, load_scenario
    from woosh_robot_agent.simulator.server import SimulatedChassis, Snapshot
    from woosh_robot_agent.simulator.serving.exchange import Interceptor, Outgoing, Received
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

_MODULES = {
    "FaultError": "faults",
    "Injection": "faults",
    "Interceptor": "serving.exchange",
    "Outgoing": "serving.exchange",
    "Received": "serving.exchange",
    "Scenario": "faults",
    "SimulatedChassis": "server",
    "SimulatorConfig": "config",
    "SimulatorThread": "thread",
    "Snapshot": "server",
    "load_scenario": "faults",
}
"""Modules of the public names. They are imported on first use, because the program must handle
signals before it imports anything slow."""


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
