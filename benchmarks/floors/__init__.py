"""What the agent is compared with: the least that rclpy and a socket cost, each a small program."""
