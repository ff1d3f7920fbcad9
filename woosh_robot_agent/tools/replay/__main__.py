"""Run the program: `python3 -m woosh_robot_agent.tools.replay`."""

import sys

from woosh_robot_agent.tools.replay import main

sys.exit(main())
