"""The cache of built message packages, scripts/message_cache."""

import gzip
import io
import os
import subprocess
import sys
import tarfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"
LIBRARY = b"\x7fELF\0" + bytes(range(256)) * 100


class Cache:
    """The program message_cache, with a cache folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.home = folder / "cache"
        self.archives = self.home / "woosh_robot_agent" / "messages"

    def run(
        self, *arguments: object, status: int | None = 0, cwd: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run it; check its exit status unless that is None."""
        done = subprocess.run(
            [sys.executable, SCRIPTS / "message_cache", *map(str, arguments)],
            env=os.environ | {"XDG_CACHE_HOME": str(self.home)},
            cwd=cwd,
            capture_output=True,
            text=True,
        )
        assert status in (done.returncode, None), done.stderr
        return done


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path)


def checkout(folder: Path, library: bytes = LIBRARY) -> Path:
    """Make an install folder with one package."""
    install = folder / "install"
    package = install / "some_msgs"
    (package / "lib").mkdir(parents=True)
    (package / "share").mkdir()
    (package / "lib" / "library.so").write_bytes(library)
    (package / "share" / "package.sh").write_text(
        f'prefix="{install}/some_msgs" PATH={folder}/.venv/bin:$PATH\n'
    )
    (package / "share" / "package.sh").chmod(0o755)
    return install


def test_packages_work_in_another_checkout(cache: Cache, tmp_path: Path) -> None:
    first = checkout(tmp_path / "first")
    # only paths of the build are changed: a checkout in /srv has `some_msgs/srv/Some`, too
    elsewhere = f"/elsewhere{tmp_path}/first/Some.srv"
    (first / "some_msgs" / "share" / "names").write_text(elsewhere)
    second = tmp_path / "the second" / "install"
    cache.run("restore", "--key", "k", second, status=1)  # there is no archive
    cache.run("store", "--key", "k", first, "some_msgs")
    (second / "some_msgs" / "share").mkdir(parents=True)
    (second / "some_msgs" / "share" / "old").touch()
    (second / "agent").mkdir()
    cache.run("restore", "--key", "k", second)
    package = second / "some_msgs"
    assert (package / "lib" / "library.so").read_bytes() == LIBRARY
    assert (package / "share" / "package.sh").read_text() == (
        f'prefix="{package}" PATH={second.parent}/.venv/bin:$PATH\n'
    )
    assert (package / "share" / "names").read_text() == elsewhere
    assert os.access(package / "share" / "package.sh", os.X_OK)
    assert not (package / "share" / "old").exists()
    assert sorted(file.name for file in second.iterdir()) == ["agent", "some_msgs"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        # Inside of the library, where only the checksum tells.
        lambda data: data[:3000] + bytes([data[3000] ^ 1]) + data[3001:],
    ],
)
def test_a_damaged_archive_is_removed_and_the_packages_stay(cache, tmp_path, damage):
    library = os.urandom(5000) + b"\0"
    install = checkout(tmp_path / "first", library)
    cache.run("store", "--key", "k", install, "some_msgs")
    (archive,) = cache.archives.iterdir()
    archive.write_bytes(damage(archive.read_bytes()))
    restored = cache.run("restore", "--key", "k", install, status=1)
    assert str(archive) in restored.stderr
    assert not archive.exists()
    assert [file.name for file in install.iterdir()] == ["some_msgs"]
    assert (install / "some_msgs" / "lib" / "library.so").read_bytes() == library


def archive_with(entry: tarfile.TarInfo) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as tar:
        tar.addfile(entry, io.BytesIO(b"x" * entry.size))
    return gzip.compress(file.getvalue())


def entry(name: str, **attributes: object) -> tarfile.TarInfo:
    made = tarfile.TarInfo(name)
    made.size = 1
    for attribute, value in attributes.items():
        setattr(made, attribute, value)
    return made


def test_an_archive_writes_nothing_outside_of_its_folder_and_nothing_with_special_rights(
    cache: Cache, tmp_path: Path
) -> None:
    link = entry("link", type=tarfile.SYMTYPE, linkname="/etc/passwd", size=0)
    cache.archives.mkdir(parents=True)
    archive = cache.archives / "k.tar.gz"
    install = tmp_path / "first" / "install"
    for unsafe in (entry("../outside"), link):
        archive.write_bytes(archive_with(unsafe))
        restored = cache.run("restore", "--key", "k", install, status=1)
        assert str(archive) in restored.stderr
        assert "Traceback" not in restored.stderr
        assert list(install.iterdir()) == []
    assert not list(tmp_path.rglob("outside"))
    archive.write_bytes(archive_with(entry("program", mode=0o4755)))
    cache.run("restore", "--key", "k", install)
    assert (install / "program").stat().st_mode & 0o7777 == 0o755


def test_a_library_with_the_path_of_its_checkout_is_not_kept(cache: Cache, tmp_path: Path) -> None:
    install = checkout(tmp_path / "first", LIBRARY + os.fsencode(tmp_path / "first" / "build"))
    stored = cache.run("store", "--key", "k", install, "some_msgs", status=1)
    assert "library.so" in stored.stderr
    assert list(cache.archives.iterdir()) == []


def test_the_newest_archives_are_kept(cache: Cache, tmp_path: Path) -> None:
    cache.archives.mkdir(parents=True)
    for number in range(7):
        archive = cache.archives / f"k{number}.tar.gz"
        archive.touch()
        os.utime(archive, (number, number))
    cache.run("store", "--key", "k7", checkout(tmp_path / "first"), "some_msgs")
    left = sorted(file.name[:2] for file in cache.archives.iterdir())
    assert left == ["k2", "k3", "k4", "k5", "k6", "k7"]


def test_the_key_depends_on_the_sources_and_not_on_the_checkout(cache, tmp_path):
    keys = []
    for name, text in (("first", "int32 a"), ("second", "int32 a"), ("third", "int32 b")):
        folder = tmp_path / name / "some_msgs"
        folder.mkdir(parents=True)
        (folder / "A.msg").write_text(text)
        keys.append(cache.run("key", "pypi", "some_msgs", cwd=tmp_path / name).stdout)
    assert keys[0] == keys[1] != keys[2]


def test_several_setups_at_once(cache: Cache, tmp_path: Path) -> None:
    """Who restores while others store gets all packages or none."""
    install = checkout(tmp_path / "first", LIBRARY * 20)

    def restore(number: int) -> bool:
        target = tmp_path / str(number) / "install"
        if cache.run("restore", "--key", "k", target, status=None).returncode == 1:
            return not any(target.iterdir()) if target.exists() else True
        return (target / "some_msgs" / "lib" / "library.so").read_bytes() == LIBRARY * 20

    with ThreadPoolExecutor(4) as pool:
        stored = [
            pool.submit(cache.run, "store", "--key", "k", install, "some_msgs") for _ in range(2)
        ]
        restored = [pool.submit(restore, number) for number in range(2)]
        assert all(future.result() for future in stored + restored)
    assert restore(99)
    assert len(list(cache.archives.iterdir())) == 1
