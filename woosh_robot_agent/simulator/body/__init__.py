"""Parts of the robot: base, battery, lifts, Wi-Fi, modes, status codes."""
