"""How results are shown: tables, plots, and the pages in `docs/` that hold them."""
