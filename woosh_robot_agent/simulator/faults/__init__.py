"""Faults of the robot and of its link, on demand.

`FAULTS` lists them all. `SimulatedChassis.inject` starts one now, a `Scenario` at a given time.
"""

from woosh_robot_agent.simulator.faults.arguments import Argument, FaultError
from woosh_robot_agent.simulator.faults.fault import Fault, Injection
from woosh_robot_agent.simulator.faults.notation import load_scenario, parse_fault
from woosh_robot_agent.simulator.faults.table import FAULTS, markdown
from woosh_robot_agent.simulator.scenario import Scenario, Step

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
