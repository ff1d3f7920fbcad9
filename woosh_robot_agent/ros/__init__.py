"""The ROS side: one node for each robot, with its services, topics, actions and standard messages.

`node` creates the agent of one robot from these. `bridge` hands work over between the executor
thread and the link thread. Only this package, the programs and the tests import rclpy.
"""
