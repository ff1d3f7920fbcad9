"""The world of the robot: maps, obstacles, collisions, laser and path planner."""
