"""Check that the libraries of MCAP recordings are installed."""

from __future__ import annotations

import importlib

from woosh_robot_agent.tools.recording.errors import RecordingError

PACKAGES = ("mcap", "mcap-protobuf-support", "foxglove-schemas-protobuf")
"""Packages on PyPI that reading and writing recordings needs."""
_MODULES = ("mcap.writer", "mcap_protobuf.schema", "foxglove_schemas_protobuf", "zstandard")


def require_libraries() -> None:
    """Check that all libraries are installed and recent enough.

    Raises:
        RecordingError: A library is missing or too old; the text says how to install it.
    """
    install = f"run: python3 -m pip install --upgrade {' '.join(PACKAGES)}"
    for name in _MODULES:
        try:
            module = importlib.import_module(name)
        except ImportError as error:
            raise RecordingError(
                f"recordings need Python packages that are not installed ({error}); {install}"
            ) from None
        if name == "mcap.writer" and not hasattr(module.Writer, "flush"):
            raise RecordingError(f"the installed mcap is older than 1.6; {install}")
