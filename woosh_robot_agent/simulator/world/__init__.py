"""The floor and what stands on it: maps, obstacles, collisions, laser and path planner."""
