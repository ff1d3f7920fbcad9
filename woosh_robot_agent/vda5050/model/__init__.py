"""Orders, states and factsheets as Python values, independent of the version of the standard."""
