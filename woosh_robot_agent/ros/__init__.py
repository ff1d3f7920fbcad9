"""The ROS side: one node for each robot, with its services, topics, actions and standard messages.

`node` creates the parts of one robot's agent. `bridge` hands work over between the executor thread
and the link thread. Only this room, the programs and the tests import rclpy.
"""
