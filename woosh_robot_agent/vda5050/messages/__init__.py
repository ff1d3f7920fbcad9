"""The messages of VDA 5050 as Python values, and how each version of the standard writes them."""
