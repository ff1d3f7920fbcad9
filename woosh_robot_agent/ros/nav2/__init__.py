"""Nav2's interfaces in front of the chassis, for programs that were written for Nav2.

`ros/standard_endpoints.py` lists the interfaces, and `layer` creates them. `goals` lets the chassis
execute the goals of Nav2's actions, and `slots` lets one goal run at a time. The actions are in
`navigation`, `planning`, `behaviors` and `docking`, with their base class in `action`, and the
services in `servers`. `pose` follows the robot's pose, `frames` transforms poses into the frame of
the map, and `cancels` remembers who has cancelled something.
"""
