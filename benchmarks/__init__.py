"""Benchmarks of the agent, run by `scripts/bench`. They print Markdown tables.

`floors/` holds the programs that the agent is compared with, `programs/` those that a measurement
starts beside them, `measurements/` what is measured, and `report/` the benchmarks of speed with
their tables, plots and pages. Each layer imports only those before it.
"""
