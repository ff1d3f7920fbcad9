"""The standard layer: the robot's data and commands as standard ROS messages.

It follows REP 103, 105, 117 and 2003. A part is usually one topic or service, e.g. scan. Each part
can be switched off by a parameter, and works in the link thread. `layer` creates the parts;
`ros/standard_endpoints.py` has the table of their topics and services.
"""
