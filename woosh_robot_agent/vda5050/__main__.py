"""Starts the connector: `python3 -m woosh_robot_agent.vda5050`."""

import sys

from woosh_robot_agent.vda5050.program import main

if __name__ == "__main__":
    sys.exit(main())
