"""Open ROS 2 driver for Woosh mobile robots, with a simulated chassis.

docs/architecture.md describes the layers; the contracts in pyproject.toml enforce them.
"""
