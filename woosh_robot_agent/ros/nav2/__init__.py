"""Nav2's interfaces in front of the chassis, for programs that were written for Nav2.

`ros/standard_endpoints.py` lists the interfaces, and `layer` creates them. `goals` runs the goals
of Nav2's actions as goals of the chassis. The actions are in `navigation`, `planning`, `behaviors`
and `docking`, and the services in `servers`. `pose` follows the robot's pose, and `frames`
transforms poses into the frame of the map.
"""
