"""The other end of the link, for programs that stand in for a chassis."""
