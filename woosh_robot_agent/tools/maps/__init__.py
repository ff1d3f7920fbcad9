"""The program `maps`: backs up the maps and marks of a robot, and uploads them to a robot."""
