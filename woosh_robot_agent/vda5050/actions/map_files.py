"""Download of the files of a map as one ZIP file."""

from __future__ import annotations

import hashlib
import http.client
import io
import time
import urllib.error
import urllib.request
import zipfile
import zlib
from pathlib import PurePosixPath
from urllib.parse import urlsplit

HASHES = {"sha256": 64, "sha1": 40, "md5": 32}
"""Supported hashes, and their lengths in hexadecimal digits."""
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
)
"""Errors of a ZIP file that is damaged, encrypted or compressed in an unknown way."""
_TIMEOUT = 30.0
"""Maximum time without any data, in seconds."""
_MAX_DURATION = 600.0
"""Maximum duration of a download, in seconds."""
_CHUNK = 64 * 1024
"""Maximum number of bytes that are read at a time."""
_MAX_BYTES = 64 * 1024 * 1024
"""Maximum size of the ZIP file, and of all files in it together, in bytes."""
_MAX_FILES = 200
"""Maximum number of files in the ZIP file."""


class MapFileError(Exception):
    """The file of a map cannot be used. The text is the reason."""


def is_link(link: str) -> bool:
    """Return True if a text is a URL from which a file can be fetched."""
    try:
        parts = urlsplit(link)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and bool(parts.hostname)


def fetch(link: str, expected: str = "") -> bytes:
    """Fetch a file; this blocks.

    Args:
        link: http or https URL.
        expected: hash of the file in hexadecimal; empty for no check.

    Raises:
        MapFileError: it cannot be fetched, is too large or too slow, or has another hash.
    """
    opener = urllib.request.OpenerDirector()  # without the handlers for local files and FTP
    for handler in (
        urllib.request.ProxyHandler,
        urllib.request.HTTPHandler,
        urllib.request.HTTPSHandler,
        urllib.request.HTTPRedirectHandler,
        urllib.request.HTTPErrorProcessor,
        urllib.request.HTTPDefaultErrorHandler,
    ):
        opener.add_handler(handler())
    data = bytearray()
    deadline = time.monotonic() + _MAX_DURATION
    try:
        with opener.open(link, timeout=_TIMEOUT) as response:
            while len(data) <= _MAX_BYTES and (chunk := response.read1(_CHUNK)):
                data += chunk
                if time.monotonic() > deadline:
                    raise MapFileError(f"the download of {link} takes too long")
    except (OSError, ValueError, http.client.HTTPException) as error:
        if isinstance(error, urllib.error.HTTPError):
            error.close()  # it holds the connection
        raise MapFileError(f"{link} cannot be fetched: {error}") from None
    if len(data) > _MAX_BYTES:
        raise MapFileError(f"{link} has more than {_MAX_BYTES} bytes")
    if expected:
        algorithm = next(name for name, size in HASHES.items() if size == len(expected))
        found = hashlib.new(algorithm, data, usedforsecurity=False).hexdigest()
        if found != expected.lower():
            raise MapFileError(f"{link} has the {algorithm} hash {found}, not {expected}")
    return bytes(data)


def unpack(data: bytes) -> dict[str, bytes]:
    """Return the files in a ZIP file by their names, without folders.

    Raises:
        MapFileError: it is no usable ZIP file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = [each for each in archive.infolist() if not each.is_dir()]
            if not entries or len(entries) > _MAX_FILES:
                raise MapFileError(f"the ZIP file has {len(entries)} files, not 1 to {_MAX_FILES}")
            if sum(each.file_size for each in entries) > _MAX_BYTES:
                raise MapFileError(f"the files in the ZIP file have more than {_MAX_BYTES} bytes")
            files = {PurePosixPath(each.filename).name: archive.read(each) for each in entries}
    except _ZIP_ERRORS as error:
        raise MapFileError(f"the downloaded file is no usable ZIP file: {error}") from None
    if len(files) < len(entries):
        raise MapFileError("two files in different folders of the ZIP file have the same name")
    return files
