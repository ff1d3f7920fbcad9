"""Everything that decides whether the robot may move. `gate` is the only way to the wheels."""
