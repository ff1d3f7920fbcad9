"""Presentation of results: tables, plots, and the pages in `docs/` that contain them."""
