"""Run the program: `python3 -m woosh_robot_agent.tools.maps`."""

import sys

from woosh_robot_agent.tools.maps import main

sys.exit(main())
