"""The measurements of speed, a module for each group of figures."""
