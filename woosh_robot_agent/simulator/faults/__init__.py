"""Faults of the robot and of its link, on demand.

`FAULTS` lists them all. `SimulatedChassis.inject` begins one now, a `Scenario` at a given time.
"""

from woosh_robot_agent.simulator.config import Scenario, Step
from woosh_robot_agent.simulator.faults.fault import FAULTS, Argument, Fault, FaultError, Injection
from woosh_robot_agent.simulator.faults.injector import load_scenario, markdown, parse_fault

__all__ = [
    "FAULTS",
    "Argument",
    "Fault",
    "FaultError",
    "Injection",
    "Scenario",
    "Step",
    "load_scenario",
    "markdown",
    "parse_fault",
]
