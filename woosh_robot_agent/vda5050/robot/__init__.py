"""What the robot reports, as values of the model."""
