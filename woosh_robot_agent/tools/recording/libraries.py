"""Check that the libraries of MCAP recordings are installed."""

from __future__ import annotations

import re

import google.protobuf

from woosh_robot_agent.tools.recording.errors import RecordingError

_PACKAGES = "mcap mcap-protobuf-support foxglove-schemas-protobuf"
"""Packages on PyPI that reading and writing recordings needs."""
_PACKAGES_FOR_OLD_PROTOBUF = "mcap 'mcap-protobuf-support<0.4' 'foxglove-schemas-protobuf<0.4'"
"""Releases that work with protobuf before 5.29, such as that of Ubuntu 24.04."""


def require_libraries() -> None:
    """Check that all libraries are installed and recent enough.

    Raises:
        RecordingError: A library is missing or too old; the text says how to install it.
    """
    release = [int(part) for part in re.findall(r"\d+", google.protobuf.__version__)[:2]]
    packages = _PACKAGES if release >= [5, 29] else _PACKAGES_FOR_OLD_PROTOBUF
    install = f"run: python3 -m pip install --upgrade {packages} (see docs/recordings.md)"
    try:
        import foxglove_schemas_protobuf.Pose_pb2  # noqa: F401
        import mcap_protobuf.schema  # noqa: F401
        import zstandard  # noqa: F401
        from mcap.writer import Writer
    except ImportError as error:
        raise RecordingError(
            f"recordings need Python packages that are not installed ({error}); {install}"
        ) from None
    if not hasattr(Writer, "flush"):
        raise RecordingError(f"the installed mcap is older than 1.6; {install}")
