"""Prints the table of all faults as Markdown."""

from woosh_robot_agent.simulator.faults.table import markdown

if __name__ == "__main__":
    print(markdown())
