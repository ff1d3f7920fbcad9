"""Requirements of the Debian package, for scripts/deb.

requirements.py unused VENV INSTALL
    print the Python distributions in the environment that the installed workspace does not need;
    it needs all of ROS 2
requirements.py debian VENV INSTALL PACKAGE_XML...
    print the Debian packages of the requirements outside the environment, and of the libraries
    that the package loads, as a value of Depends
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


def site(prefix: Path) -> list[str]:
    """Return the folders of Python packages in a prefix."""
    return [str(path) for path in prefix.glob("lib/python3.*/site-packages")]


def installed(prefix: Path) -> dict[str, metadata.Distribution]:
    """Return the distributions that pip installed in a prefix, by name.

    The wheels of ROS contain further ones, without a list of their files.
    """
    return {
        canonicalize_name(distribution.metadata["Name"]): distribution
        for distribution in metadata.distributions(path=site(prefix))
        if distribution.read_text("RECORD") is not None
    }


def required_by(distribution: metadata.Distribution, extras: set[str]) -> Iterator[Requirement]:
    """Yield the requirements of a distribution with some of its extras."""
    for line in distribution.requires or ():
        requirement = Requirement(line)
        marker = requirement.marker
        if not marker or any(marker.evaluate({"extra": extra}) for extra in {"", *extras}):
            yield requirement


def needed(venv: Path, install: Path) -> dict[str, metadata.Distribution]:
    """Return the distributions that the workspace needs, the system's included, by name."""
    (agent,) = (
        distribution
        for distribution in metadata.distributions(path=site(install))
        if canonicalize_name(distribution.metadata["Name"]) == "woosh-robot-agent"
    )
    here = installed(venv)
    found = {name: here[name] for name in here if name.startswith("ros-")}
    waiting = [
        requirement
        for distribution, extras in (
            (agent, {"recording", "fast", "vda5050"}),
            *((ros, set[str]()) for ros in found.values()),
        )
        for requirement in required_by(distribution, extras)
    ]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name in found:
            continue
        try:
            found[name] = here.get(name) or metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue  # wheels of ROS name some build tools by older names
        waiting += required_by(found[name], requirement.extras)
    return found


def owner(path: Path) -> str | None:
    """Return the Debian package that owns a file."""
    # Where /lib is a link to /usr/lib, packages list one or the other path.
    for name in {str(path), str(path.resolve()), str(path.resolve()).removeprefix("/usr")}:
        result = subprocess.run(["dpkg", "-S", name], capture_output=True, text=True, check=False)
        if result.returncode == 0:
            return result.stdout.split(":")[0]
    return None


def libraries_outside(install: Path) -> Iterator[tuple[str, Path]]:
    """Yield name and path of each shared library that the package loads and does not contain.

    dpkg-shlibdeps needs minutes for this, and does not find libraries that a wheel contains.
    """
    files = [path for path in install.rglob("*") if path.is_file() and not path.is_symlink()]
    files = [path for path in files if is_elf(path)]
    output = subprocess.run(
        ["readelf", "--dynamic", "--wide", *files], capture_output=True, text=True, check=True
    ).stdout
    wanted = set(re.findall(r"\(NEEDED\).*\[(.+)\]", output)) - {
        path.name for path in install.rglob("*.so*")
    }
    cache = subprocess.run(
        ["/sbin/ldconfig", "-p"], capture_output=True, text=True, check=True
    ).stdout
    # the loader takes the first of several files with a name; `dict` keeps the last
    system = dict(reversed(re.findall(r"^\s+(\S+) \(.* => (.+)$", cache, re.MULTILINE)))
    folders = [Path(path) for path in os.environ.get("LD_LIBRARY_PATH", "").split(":") if path]
    for name in sorted(wanted):
        found = next((folder / name for folder in folders if (folder / name).exists()), None)
        yield name, found or Path(system.get(name, name))


def is_elf(path: Path) -> bool:
    """Return True for a program or a shared library."""
    with path.open("rb") as file:
        return file.read(4) == b"\x7fELF"


def info_folder(name: str, distribution: metadata.Distribution) -> Path:
    """Return the folder or file with the metadata of a distribution."""
    folder = Path(str(distribution.locate_file("")))
    for path in folder.glob("*.*-info"):
        if canonicalize_name(path.name.split("-")[0]) == name:
            return path
    return folder / name


def files_outside(venv: Path, install: Path, manifests: list[str]) -> Iterator[tuple[str, Path]]:
    """Yield name and a file of each requirement outside the environment and the workspace."""
    here = installed(venv)
    for name, distribution in needed(venv, install).items():
        if name not in here:
            yield name, info_folder(name, distribution)
    trees = [ElementTree.parse(manifest).getroot() for manifest in manifests]
    own = {tree.findtext("name") for tree in trees}
    names = {
        str(dependency.text)
        for tree in trees
        for tag in ("depend", "exec_depend")
        for dependency in tree.findall(tag)
    }
    prefixes = [Path(path) for path in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if path]
    for name in sorted(names - own):
        for prefix in prefixes:
            manifest = prefix / "share" / name / "package.xml"
            if prefix != venv and manifest.exists():
                yield name, manifest
                break


def main() -> None:
    """Run one of the commands."""
    command, venv, install = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    if command == "unused":
        print(*sorted(installed(venv).keys() - needed(venv, install).keys()), sep="\n")
    else:
        owners = set()
        for name, path in (
            *files_outside(venv, install, sys.argv[4:]),
            *libraries_outside(install),
        ):
            package = owner(path)
            if package:
                owners.add(package)
            else:
                print(
                    f"[deb] {name} is not from a Debian package; install it on the robot at {path}",
                    file=sys.stderr,
                )
        print(*sorted(owners), sep=", ")


if __name__ == "__main__":
    main()
