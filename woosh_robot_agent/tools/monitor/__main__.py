"""Run the program: `python3 -m woosh_robot_agent.tools.monitor`."""

import sys

from woosh_robot_agent.tools.monitor import main

sys.exit(main())
