"""Measurements of robustness and speed, each printed as a Markdown table: `scripts/bench`."""
