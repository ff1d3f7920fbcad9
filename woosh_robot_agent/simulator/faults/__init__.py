"""Everything that can go wrong with a chassis and its link, on demand.

`FAULTS` is the table. `SimulatedChassis.inject` puts one in now, a `Scenario` does so by schedule.
"""

from woosh_robot_agent.simulator.faults.fault import Fault, Injection
from woosh_robot_agent.simulator.faults.parameters import FaultError, Parameter
from woosh_robot_agent.simulator.faults.scenario import Scenario, Step, load_scenario, parse_fault
from woosh_robot_agent.simulator.faults.table import FAULTS, markdown

__all__ = [
    "FAULTS",
    "Fault",
    "FaultError",
    "Injection",
    "Parameter",
    "Scenario",
    "Step",
    "load_scenario",
    "markdown",
    "parse_fault",
]
