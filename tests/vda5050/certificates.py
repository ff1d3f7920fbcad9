"""Certificates for tests, made with openssl."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path


def openssl_path() -> str | None:
    return shutil.which("openssl")


class Authority:
    """A certificate authority with its files in a folder.

    Attributes:
        certificate: its own certificate.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._folder = folder
        self.certificate = folder / "ca.crt"
        self._key = folder / "ca.key"
        self.run(
            *("req", "-x509", "-new", "-nodes", "-days", "2", "-subj", "/CN=test authority"),
            *("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"),
            *("-addext", "keyUsage=critical,keyCertSign,cRLSign"),
            *("-keyout", self._key, "-out", self.certificate),
        )

    def issue(self, name: str) -> tuple[Path, Path]:
        """Make a certificate for a name at 127.0.0.1; return its file and that of its key."""
        certificate, key, request, extensions = (
            self._folder / f"{name}.{suffix}" for suffix in ("crt", "key", "csr", "ext")
        )
        extensions.write_text("subjectAltName=IP:127.0.0.1\n")
        self.run(
            *("req", "-new", "-nodes", "-subj", f"/CN={name}", "-newkey", "ec"),
            *("-pkeyopt", "ec_paramgen_curve:prime256v1", "-keyout", key, "-out", request),
        )
        self.run(
            *("x509", "-req", "-days", "2", "-in", request, "-out", certificate),
            *("-CA", self.certificate, "-CAkey", self._key, "-CAcreateserial"),
            *("-extfile", extensions),
        )
        return certificate, key

    def run(self, *arguments: object) -> None:
        path = openssl_path()
        assert path
        subprocess.run([path, *map(str, arguments)], check=True, capture_output=True)
