"""Benchmarks of the agent, each printed as Markdown tables: `scripts/bench`.

`floors/` holds the programs that the agent is compared with, `programs/` those that a measurement
starts beside them, `measurements/` what is measured, and `report/` tables, plots and pages.
"""
