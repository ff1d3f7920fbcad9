"""The messages of each version of the standard."""
