"""Parts of the robot: base, battery, lifts, modes, log of status codes."""
