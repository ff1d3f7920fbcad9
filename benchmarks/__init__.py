"""Benchmarks of the agent, run by `scripts/bench`. README.md explains them."""
