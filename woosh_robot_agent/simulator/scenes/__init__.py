"""Scenes: maps with marks and tasks, read from files.

Functions that read or check a file raise `DataFileError` if it cannot be used.
"""
