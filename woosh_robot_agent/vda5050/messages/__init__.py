"""The messages of VDA 5050: what they mean in all versions, and how each version writes them."""
