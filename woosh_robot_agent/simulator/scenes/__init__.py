"""Scenes: maps with marks and tasks, read from files."""
