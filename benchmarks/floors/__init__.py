"""Floors: small programs that show the least that rclpy and a socket cost.

They import nothing of the agent, because the cost of that is part of what is measured.
"""
