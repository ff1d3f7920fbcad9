"""Programs to observe one robot: `monitor`, `doctor`, `record` and `replay`.

None of them commands the robot. Only `monitor.ros_source` needs ROS.
"""
