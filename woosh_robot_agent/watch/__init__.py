"""Observation of the robot and of its commands, for the log and for diagnostics.

Nothing here sends anything to the robot or changes what is sent. Each module observes one matter.
"""
