"""Nav2's interfaces in front of the chassis, for programs that were written for Nav2.

`endpoints` lists them, and `layer` creates them. `goals` runs the goals of Nav2's actions as goals
of the chassis. The actions are in `navigation`, `planning`, `behaviors` and `docking`, and the
services and topics in `servers`. `frames` brings poses into the frame of the map.
"""
