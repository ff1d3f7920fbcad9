"""Requests, answers, pushes and reports, as protobuf messages.

Handlers, and the functions that check values for them, raise `RefusedError` to refuse a request.
"""

from woosh_robot_agent.simulator.protocol import (
    action_commands,  # noqa: F401 - adds its handlers
    map_commands,  # noqa: F401 - adds its handlers
    state_commands,  # noqa: F401 - adds its handlers
    task_commands,  # noqa: F401 - adds its handlers
)
