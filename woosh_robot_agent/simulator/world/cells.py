"""Values of the cells of a map."""

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of cells, as in nav_msgs/OccupancyGrid. Values between FREE and OCCUPIED count as free."""
