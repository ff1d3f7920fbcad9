"""What is measured: a module for each benchmark of speed, and one for each group of its figures."""
