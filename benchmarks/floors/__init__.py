"""Floors: minimal programs that show the lowest possible cost with rclpy and a socket.

They do not import the agent, because its import is part of the measured cost.
"""
