"""The benchmarks of speed (`speed`, `links`, `scale`), and a module for each group of figures."""
