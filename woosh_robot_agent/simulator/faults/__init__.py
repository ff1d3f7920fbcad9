"""Faults of the robot and of its link.

`FAULTS` lists them all. `SimulatedChassis.inject` begins one now, a `Scenario` at a given time.
"""

from woosh_robot_agent.simulator.config import Scenario
from woosh_robot_agent.simulator.faults import (
    chassis_faults,  # noqa: F401 - adds its faults
    link_faults,  # noqa: F401 - adds its faults
)
from woosh_robot_agent.simulator.faults.fault import (
    FAULTS,
    FaultError,
    Injection,
    load_scenario,
    markdown,
    parse_fault,
)

__all__ = [
    "FAULTS",
    "FaultError",
    "Injection",
    "Scenario",
    "load_scenario",
    "markdown",
    "parse_fault",
]
