"""Knowledge about a robot: its last values, what drives it, why it stands, what it would refuse.

Nothing here sends a command to the robot or changes what is sent.
"""
