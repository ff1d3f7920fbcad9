"""Measure scripts/setup in new checkouts: with empty caches, then with filled ones.

scripts/bench --setup                 print the table; takes some minutes

The checkouts have the last commit, and are removed at the end. The first one downloads the packages
from PyPI; system packages are those of this machine.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figures import Results, Target
from benchmarks.processes import ROOT

_STDERR = 2
"""File descriptor of stderr."""
TARGETS = {
    "setup": Target(240.0, 180.0, "seconds of `scripts/setup`, with empty caches"),
    "setup_again": Target(60.0, 45.0, "the same for a second checkout on the same machine"),
}


def measure(repository: Path) -> dict[str, float]:
    """Set up two new checkouts one after the other; return how long each took, in seconds."""
    with tempfile.TemporaryDirectory() as folder:
        caches = Path(folder, "caches")
        return {name: _set_up(repository, Path(folder, name), caches) for name in TARGETS}


def _set_up(repository: Path, checkout: Path, caches: Path) -> float:
    """Make a checkout; return the time of its set-up, in seconds."""
    subprocess.run(["git", "clone", "--quiet", repository, checkout], check=True)
    environment = {
        **os.environ,
        "CCACHE_DIR": str(caches / "ccache"),
        "PIP_CACHE_DIR": str(caches / "pip"),
        "UV_CACHE_DIR": str(caches / "uv"),
        "XDG_CACHE_HOME": str(caches),
    }
    begun = time.monotonic()
    subprocess.run(
        [checkout / "scripts/setup"],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=_STDERR,  # only the table goes to stdout
        check=True,
    )
    return time.monotonic() - begun


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table. The exit status is 0, because machines differ too much."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench --setup",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.parse_args(arguments)
    results = Results()
    results.add({name: (value, f"{value:.0f} s") for name, value in measure(ROOT).items()})
    print(results.table(TARGETS))
    return 0
