"""Programs for one robot: `monitor`, `doctor`, `record`, `replay` and `maps`.

Only `maps` changes something on the robot. Only `monitor.ros_source` and `record.ros_recorder`
need ROS.
"""
