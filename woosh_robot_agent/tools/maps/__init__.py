"""The program `maps`: backs up the maps and marks of a robot, and brings them to a robot."""
