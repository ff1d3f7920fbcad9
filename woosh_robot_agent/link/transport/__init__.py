"""Transports: connections that carry whole frames, as a client sees them."""
