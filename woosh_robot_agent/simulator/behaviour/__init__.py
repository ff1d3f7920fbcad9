"""What the robot does over time: tasks, actions and the jobs that they consist of."""
