"""The program `doctor`: checks the connection to a robot and whether it accepts tasks."""
