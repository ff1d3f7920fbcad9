"""Messages of the agent itself, which mirror no message of the chassis."""

from __future__ import annotations

from woosh_robot_agent.interfaces.definition import Line, message_text

OWN_MESSAGES = {
    "woosh_robot_msgs/AgentInfo": message_text(
        "State of the agent",
        [Line("bool online", "True while the link to the chassis is ready")],
    )
}
"""Content of the .msg files, by ROS type."""
