"""Names of scenes, maps and files as file names.

The names come from a robot, which may call a file `../../.bashrc`. Characters that could make a
name a path, or that some file systems do not have, are written as in URLs.
"""

from __future__ import annotations

from woosh_robot_agent.tools.maps.errors import MapsError

_UNSAFE = frozenset('/\\:*?"<>|%')
"""Characters that a file name does not have. `%` is one, so that names stay different."""
_MAX_BYTES = 200
"""Maximum length of a file name, in bytes. Most file systems have a limit of 255."""


def to_file_name(name: str, suffix: str = "") -> str:
    """Return a file name for any name. Different names have different file names.

    Args:
        name: The name.
        suffix: End of the file name, which is added unchanged.

    Raises:
        MapsError: The name is empty or too long.
    """
    quoted = "".join(map(_quoted, name))
    if quoted.startswith("."):  # hidden, or this folder or the one above
        quoted = f"%2E{quoted[1:]}"
    if not name or len((quoted + suffix).encode()) > _MAX_BYTES:
        raise MapsError(
            f"the name {name[:50]!r} cannot be a file name: it is empty or too long; rename it on "
            "the robot"
        )
    return quoted + suffix


def _quoted(character: str) -> str:
    if character.isprintable() and character not in _UNSAFE:
        return character
    return "".join(f"%{byte:02X}" for byte in character.encode())
