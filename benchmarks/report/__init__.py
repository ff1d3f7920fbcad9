"""The benchmarks of speed: `speed`, `links`, `scale`, with tables, plots and pages in `docs/`."""
