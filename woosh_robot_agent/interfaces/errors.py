"""Errors of the generation of interface files."""


class InterfaceError(Exception):
    """The interface files cannot be generated; the text says why."""
