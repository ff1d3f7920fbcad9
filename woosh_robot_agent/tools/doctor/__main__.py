"""Run the program: `python3 -m woosh_robot_agent.tools.doctor`."""

import sys

from woosh_robot_agent.tools.doctor import main

sys.exit(main())
