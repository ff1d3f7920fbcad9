"""Programs to look at one robot: `monitor`, `doctor`, `record` and `replay`.

None of them commands the robot. All but the monitor's ROS side work where there is no ROS.
"""
