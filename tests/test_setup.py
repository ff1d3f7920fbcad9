"""Parts of scripts/setup: the cache of built message packages, the settings of uv, the progress."""

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
LIBRARY = b"\x7fELF\0" + bytes(range(256)) * 100


class Cache:
    """The program message_cache, with a cache folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.home = folder / "cache"
        self.archives = self.home / "woosh_robot_agent" / "messages"

    def run(self, *arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, SCRIPTS / "message_cache", *map(str, arguments)],
            env=os.environ | {"XDG_CACHE_HOME": str(self.home)},
            cwd=cwd,
            capture_output=True,
            text=True,
        )


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path)


def checkout(folder: Path, library: bytes = LIBRARY) -> Path:
    """Make an install folder with one package, with links into the build folder as CMake does."""
    install = folder / "install"
    package = install / "some_msgs"
    (package / "lib").mkdir(parents=True)
    (package / "share").mkdir()
    build = folder / "build"
    build.mkdir()
    (build / "library.so").write_bytes(library)
    (package / "lib" / "library.so").symlink_to(build / "library.so")
    (package / "share" / "package.sh").write_text(f'prefix="{install}/some_msgs"\n')
    (package / "share" / "package.sh").chmod(0o755)
    return install


def test_packages_work_in_another_checkout(cache: Cache, tmp_path: Path) -> None:
    first = checkout(tmp_path / "first")
    assert cache.run("store", "--key", "k", first, "some_msgs").returncode == 0
    second = tmp_path / "the second" / "install"
    (second / "some_msgs" / "share").mkdir(parents=True)
    (second / "some_msgs" / "share" / "old").touch()
    (second / "agent").mkdir()
    assert cache.run("restore", "--key", "k", second).returncode == 0
    package = second / "some_msgs"
    assert (package / "lib" / "library.so").read_bytes() == LIBRARY
    assert not (package / "lib" / "library.so").is_symlink()
    assert (package / "share" / "package.sh").read_text() == f'prefix="{package}"\n'
    assert os.access(package / "share" / "package.sh", os.X_OK)
    assert not (package / "share" / "old").exists()
    assert sorted(file.name for file in second.iterdir()) == ["agent", "some_msgs"]


def test_nothing_is_restored_without_an_archive(cache: Cache, tmp_path: Path) -> None:
    install = checkout(tmp_path / "first")
    assert cache.run("restore", "--key", "k", install).returncode == 1
    assert (install / "some_msgs" / "share" / "package.sh").exists()


@pytest.mark.parametrize(
    "damage",
    [lambda data: data[: len(data) // 2], lambda data: data[:200] + b"x" * 50 + data[250:]],
)
def test_a_damaged_archive_is_removed_and_the_packages_stay(
    cache: Cache, tmp_path: Path, damage
) -> None:
    install = checkout(tmp_path / "first", os.urandom(5000) + b"\0")
    cache.run("store", "--key", "k", install, "some_msgs")
    (archive,) = cache.archives.iterdir()
    archive.write_bytes(damage(archive.read_bytes()))
    restored = cache.run("restore", "--key", "k", install)
    assert restored.returncode == 1
    assert str(archive) in restored.stderr
    assert not archive.exists()
    assert [file.name for file in install.iterdir()] == ["some_msgs"]
    assert (install / "some_msgs" / "lib" / "library.so").is_symlink()


def test_a_library_with_the_path_of_its_checkout_is_not_kept(cache: Cache, tmp_path: Path) -> None:
    install = checkout(tmp_path / "first", LIBRARY + os.fsencode(tmp_path / "first" / "build"))
    stored = cache.run("store", "--key", "k", install, "some_msgs")
    assert stored.returncode != 0
    assert "library.so" in stored.stderr
    assert list(cache.archives.iterdir()) == []


def test_several_setups_at_once(cache: Cache, tmp_path: Path) -> None:
    """Who restores while others store gets all packages or none."""
    install = checkout(tmp_path / "first", LIBRARY * 20)

    def restore(number: int) -> bool:
        target = tmp_path / str(number) / "install"
        if cache.run("restore", "--key", "k", target).returncode == 1:
            return not any(target.iterdir()) if target.exists() else True
        return (target / "some_msgs" / "lib" / "library.so").read_bytes() == LIBRARY * 20

    with ThreadPoolExecutor(8) as pool:
        stored = [
            pool.submit(cache.run, "store", "--key", "k", install, "some_msgs") for _ in range(4)
        ]
        restored = [pool.submit(restore, number) for number in range(4)]
        assert all(future.result().returncode == 0 for future in stored)
        assert all(future.result() for future in restored)
    assert restore(99)
    assert len(list(cache.archives.iterdir())) == 1


def test_the_newest_archives_are_kept(cache: Cache, tmp_path: Path) -> None:
    install = checkout(tmp_path / "first")
    for number in range(8):
        cache.run("store", "--key", f"k{number}", install, "some_msgs")
        os.utime(cache.archives / f"k{number}.tar.gz", (number, number))
    assert sorted(file.name[:2] for file in cache.archives.iterdir()) == [
        "k2",
        "k3",
        "k4",
        "k5",
        "k6",
        "k7",
    ]


def test_the_key_depends_on_the_sources_and_not_on_the_checkout(
    cache: Cache, tmp_path: Path
) -> None:
    keys = []
    for name, text in (("first", "int32 a"), ("second", "int32 a"), ("third", "int32 b")):
        folder = tmp_path / name / "some_msgs"
        folder.mkdir(parents=True)
        (folder / "A.msg").write_text(text)
        done = cache.run("key", "pypi", "some_msgs", cwd=tmp_path / name)
        assert done.returncode == 0, done.stderr
        keys.append(done.stdout)
    assert keys[0] == keys[1] != keys[2]


def test_uv_gets_the_settings_of_pip() -> None:
    settings = """\
:env:.find-links='/wheels /more wheels'
global.extra-index-url='https://one/simple\\nfile:///two'
global.index-url='https://global/simple'
install.index-url="https://it's/simple"
"""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("UV_")}
    script = (
        f'eval "$({sys.executable} {SCRIPTS}/uv_settings)"; '
        'printf "%s\\n" "$UV_DEFAULT_INDEX" "$UV_INDEX"'
    )
    done = subprocess.run(
        ["bash", "-c", script],
        env=environment,
        input=settings,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == ["https://it's/simple", "https://one/simple file:///two"]


def test_a_long_step_tells_how_far_it_is(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("first\nDownloading scipy (33 MB)\n")
    script = f". {SCRIPTS}/progress; progress_start last_line {log}; cat; progress_stop"
    with subprocess.Popen(
        ["bash", "-c", script],
        env=os.environ | {"WOOSH_PROGRESS_INTERVAL": "0.05"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as step:
        assert step.stdin
        assert step.stdout
        assert step.stdout.readline().startswith("[setup]     Downloading scipy (33 MB) after ")
        step.stdin.close()
        step.stdout.read()  # ends, because nothing is left behind that holds the pipe
    assert step.returncode == 0


@pytest.mark.parametrize(
    ("steps", "seconds", "left"),
    [
        ("[1/10] first\n[5/10] second\nsomething\n", 2000, r" about 20\d\d s left,"),
        ("[9/10] install\n", 100, r" about 4\d s left,"),
        ("[10/10] install\n", 15, ""),
    ],
)
def test_the_build_tells_package_and_time_left(
    tmp_path: Path, steps: str, seconds: int, left: str
) -> None:
    for name, count in (("woosh_a_msgs", 10), ("woosh_b_msgs", 20), ("tests/ros/c_msgs", 10)):
        for number in range(count):
            message = tmp_path / name / "msg" / f"M{number}.msg"
            message.parent.mkdir(parents=True, exist_ok=True)
            message.touch()
    log = tmp_path / "log" / "latest_build" / "woosh_b_msgs" / "stdout.log"
    log.parent.mkdir(parents=True)
    log.write_text(steps)
    (tmp_path / "colcon").write_text(
        "Starting >>> woosh_a_msgs\nStarting >>> woosh_b_msgs\nFinished <<< woosh_a_msgs\n"
    )
    script = f". {SCRIPTS}/progress; SECONDS={seconds}; progress_packages colcon"
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    # bash goes on counting the seconds.
    assert re.fullmatch(rf"1 of 3 message packages, at woosh_b_msgs,{left}\n", done.stdout)
