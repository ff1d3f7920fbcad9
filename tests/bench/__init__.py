"""Measurements of the agent's robustness, each printed as a Markdown table: `scripts/bench`."""
