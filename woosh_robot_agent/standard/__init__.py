"""The standard layer: the robot in the terms of ROS (REP 103, 105, 117 and 2003).

Each part is a module of its own, can be switched off by a parameter, and works in the link's
thread. `layer` puts them together, `table` says what topics and services there are.
"""
