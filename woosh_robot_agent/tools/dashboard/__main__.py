"""Run the program: `python3 -m woosh_robot_agent.tools.dashboard`."""

import sys

from woosh_robot_agent.tools.dashboard import main

sys.exit(main())
