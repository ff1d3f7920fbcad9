"""Tools, i.e. programs for robots: `dashboard`, `monitor`, `doctor`, `record`, `replay`, `maps`.

Only `maps` and `dashboard --control` change something on the robot; `record --listen` forwards the
commands of others. Only `ros_node`, `monitor.ros_source` and `recording.ros_recorder` need ROS.
"""
