"""Run the program: `python3 -m woosh_robot_agent.tools.record`."""

import sys

from woosh_robot_agent.tools.record import main

sys.exit(main())
