"""Parts of scripts/setup: the cache of message packages, settings of uv, progress, releases."""

import gzip
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
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
    (package / "share" / "package.sh").write_text(
        f'prefix="{install}/some_msgs" PATH={folder}/.venv/bin:$PATH\n'
    )
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
    assert (package / "share" / "package.sh").read_text() == (
        f'prefix="{package}" PATH={second.parent}/.venv/bin:$PATH\n'
    )
    assert os.access(package / "share" / "package.sh", os.X_OK)
    assert not (package / "share" / "old").exists()
    assert sorted(file.name for file in second.iterdir()) == ["agent", "some_msgs"]


def test_nothing_is_restored_without_an_archive(cache: Cache, tmp_path: Path) -> None:
    install = checkout(tmp_path / "first")
    assert cache.run("restore", "--key", "k", install).returncode == 1
    assert (install / "some_msgs" / "share" / "package.sh").exists()


def test_only_paths_of_the_build_are_changed(cache: Cache, tmp_path: Path) -> None:
    """A checkout in /srv would otherwise change `some_msgs/srv/Some`."""
    install = checkout(tmp_path / "first")
    text = f"/elsewhere{tmp_path}/first/Some.srv"
    (install / "some_msgs" / "share" / "names").write_text(text)
    assert cache.run("store", "--key", "k", install, "some_msgs").returncode == 0
    second = tmp_path / "second" / "install"
    assert cache.run("restore", "--key", "k", second).returncode == 0
    assert (second / "some_msgs" / "share" / "names").read_text() == text


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        lambda data: data[:200] + b"x" * 50 + data[250:],
        # Inside of the library, where only the checksum tells.
        lambda data: data[:3000] + bytes([data[3000] ^ 1]) + data[3001:],
    ],
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


@pytest.mark.parametrize(
    "unsafe",
    [
        entry("../outside"),
        entry("some_msgs/../../outside"),
        entry("{tmp_path}/outside"),
        entry("link", type=tarfile.SYMTYPE, linkname="/etc/passwd", size=0),
        entry("pipe", type=tarfile.FIFOTYPE, size=0),
    ],
    ids=lambda unsafe: unsafe.name,
)
def test_an_archive_writes_nothing_outside_of_its_folder(
    cache: Cache, tmp_path: Path, unsafe: tarfile.TarInfo
) -> None:
    unsafe.name = unsafe.name.format(tmp_path=tmp_path)
    cache.archives.mkdir(parents=True)
    archive = cache.archives / "k.tar.gz"
    archive.write_bytes(archive_with(unsafe))
    install = tmp_path / "first" / "install"
    restored = cache.run("restore", "--key", "k", install)
    assert restored.returncode == 1
    assert str(archive) in restored.stderr
    assert "Traceback" not in restored.stderr
    assert list(install.iterdir()) == []
    assert not list(tmp_path.rglob("outside"))


def test_restored_files_have_no_special_rights(cache: Cache, tmp_path: Path) -> None:
    cache.archives.mkdir(parents=True)
    (cache.archives / "k.tar.gz").write_bytes(archive_with(entry("program", mode=0o4755)))
    assert cache.run("restore", "--key", "k", tmp_path / "install").returncode == 0
    assert (tmp_path / "install" / "program").stat().st_mode & 0o7777 == 0o755


def test_an_archive_stays_if_the_packages_cannot_be_written(cache: Cache, tmp_path: Path) -> None:
    cache.run("store", "--key", "k", checkout(tmp_path / "first"), "some_msgs")
    (tmp_path / "file").touch()
    restored = cache.run("restore", "--key", "k", tmp_path / "file" / "install")
    assert restored.returncode == 1
    assert restored.stderr.startswith("cannot restore")
    assert (cache.archives / "k.tar.gz").exists()


def test_a_cache_that_cannot_be_written_is_told_in_one_line(cache: Cache, tmp_path: Path) -> None:
    cache.home.touch()
    stored = cache.run("store", "--key", "k", checkout(tmp_path / "first"), "some_msgs")
    assert stored.returncode == 1
    assert re.fullmatch(r"cannot store .*\n", stored.stderr)


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
:env:.proxy='user:\\'"word@proxy:80'
global.extra-index-url='https://one/simple\\nfile:///two'
global.index-url='https://global/simple'
install.index-url="https://it's/simple"
"""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("UV_")}
    done = subprocess.run(
        [sys.executable, SCRIPTS / "uv_settings"],
        env=environment,
        input=settings,
        capture_output=True,
        text=True,
        check=True,
    )
    variables = dict(line.split("=", 1) for line in done.stdout.splitlines())
    assert variables["UV_DEFAULT_INDEX"] == "https://it's/simple"
    assert variables["UV_INDEX"] == "https://one/simple file:///two"
    assert variables["UV_FIND_LINKS"] == "/wheels,/more,wheels"
    assert variables["ALL_PROXY"] == "user:'\"word@proxy:80"


@pytest.mark.parametrize(("value", "status"), [("1", 1), ("true", 1), ("0", 0), ("false", 0)])
def test_uv_is_not_used_if_pip_may_ask_no_index(value: str, status: int) -> None:
    done = subprocess.run(
        [sys.executable, SCRIPTS / "uv_settings"],
        input=f"install.no-index='{value}'\n",
        capture_output=True,
        text=True,
    )
    assert done.returncode == status


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
        assert re.fullmatch(
            r"\[setup\]     \d+ s: Downloading scipy \(33 MB\)\n", step.stdout.readline()
        )
        step.stdin.close()
        step.stdout.read()  # ends, because nothing is left behind that holds the pipe
    assert step.returncode == 0


def test_nothing_is_left_of_the_progress_of_a_killed_script(tmp_path: Path) -> None:
    script = f". {SCRIPTS}/progress; progress_start last_line {tmp_path}/log; read -r"
    with subprocess.Popen(
        ["bash", "-c", script],
        env=os.environ | {"WOOSH_PROGRESS_INTERVAL": "0.05"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as step:
        assert step.stdout
        step.stdout.readline()
        step.kill()
        step.stdout.read()  # ends, although nobody has waited for the script yet


@pytest.mark.parametrize(
    ("steps", "seconds", "left"),
    [
        ("[1/10] first\n[5/10] second\nsomething\n", 2000, r", about 20\d\d s left"),
        ("[9/10] install\n", 100, r", about 4\d s left"),
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
    packages = "woosh_a_msgs woosh_b_msgs tests/ros/c_msgs"
    script = f". {SCRIPTS}/progress; SECONDS={seconds}; progress_packages colcon {packages}"
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    # bash goes on counting the seconds.
    assert re.fullmatch(
        rf"1 of 3 message packages are built, now woosh_b_msgs{left}\n", done.stdout
    )


@pytest.fixture
def releases(tmp_path: Path) -> Path:
    """A checkout, with a space in its path, in which Jazzy and Kilted have been set up."""
    root = tmp_path / "a checkout"
    (root / "scripts").mkdir(parents=True)
    for name in ("setup", "env", "progress", "versions.txt"):
        shutil.copy(SCRIPTS / name, root / "scripts")
    (root / "bin").mkdir()
    (root / "bin" / "apt-get").symlink_to("/bin/false")
    for suffix in ("", "-kilted"):
        programs = root / f".venv{suffix}" / "bin"
        programs.mkdir(parents=True)
        (root / f".venv{suffix}" / "ros-from-pypi").touch()
        # Stands for any program of the environment.
        (programs / "python").write_text(
            '#!/usr/bin/env bash\n[ "$1" = -c ] || { env | sort; exit 1; }\n'
        )
        (programs / "python").chmod(0o755)
        state = root / f"build{suffix}" / "setup"
        state.mkdir(parents=True)
        (state / "ready").touch()
        (root / f"install{suffix}").mkdir()
        (root / f"install{suffix}" / "local_setup.bash").touch()
    return root


def in_bash(script: str, root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run commands in a checkout, in a bash without ROS and without apt-get."""
    environment = {"PATH": f"{root}/bin:/usr/bin:/bin", "HOME": str(root / "home")}
    return subprocess.run(
        ["bash", *options, "-c", script],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
    )


def test_a_shell_can_change_between_releases(releases: Path) -> None:
    script = """
    for WOOSH_ROS in '' kilted kilted '' kilted; do
      . scripts/env
      echo "$ROS_DISTRO|$(command -v python)|$AMENT_PREFIX_PATH|$PATH"
    done
    """
    done = in_bash(script, releases, "-eu")
    jazzy, kilted = (
        f"{name}|{venv}/bin/python|{venv}|{venv}/bin:{releases}/bin:/usr/bin:/bin"
        for name, venv in (("jazzy", releases / ".venv"), ("kilted", releases / ".venv-kilted"))
    )
    assert done.stdout.splitlines() == [jazzy, kilted, kilted, jazzy, kilted], done.stderr


def test_a_shell_stays_as_it_is_if_a_release_is_not_built(releases: Path) -> None:
    (releases / "build" / "setup" / "ready").unlink()
    script = """
    export WOOSH_ROS=kilted; . scripts/env; before=$(export)
    unset WOOSH_ROS; . scripts/env || echo failed
    [ "$before" = "$(export WOOSH_ROS=kilted; export)" ] && echo unchanged
    """
    done = in_bash(script, releases)
    assert done.stdout.split() == ["failed", "unchanged"]
    assert "export WOOSH_ROS=kilted" in done.stderr


@pytest.mark.parametrize("sourced", ["", "kilted"])
def test_a_release_is_set_up_in_a_shell_for_another_one(releases: Path, sourced: str) -> None:
    other = "" if sourced else "kilted"
    script = f"""
    WOOSH_ROS={sourced}; . scripts/env
    hash=$(sha256sum scripts/setup scripts/versions.txt | sha256sum)
    export WOOSH_ROS={other}
    echo "$PWD pypi {other or "jazzy"}  $hash" >build{other and "-kilted"}/setup/environment
    scripts/setup
    """
    done = in_bash(script, releases)
    assert done.returncode == 1
    assert "3/4 protobuf modules" in done.stdout
    # The program that makes the modules has failed, and has printed its environment.
    assert f"ROS_DISTRO={other or 'jazzy'}\n" in done.stderr
    assert f"AMENT_PREFIX_PATH={releases}/.venv{other and '-kilted'}\n" in done.stderr


@pytest.mark.parametrize("home", ["HOME=$PWD/scripts/setup", "XDG_CACHE_HOME=/proc"])
def test_caches_that_cannot_be_written_are_moved(releases: Path, home: str) -> None:
    script = f"""
    hash=$(sha256sum scripts/setup scripts/versions.txt | sha256sum)
    echo "$PWD pypi jazzy  $hash" >build/setup/environment
    {home} scripts/setup
    """
    done = in_bash(script, releases)
    assert "not writable" in done.stdout
    assert f"XDG_CACHE_HOME={releases}/build/cache\n" in done.stderr


@pytest.mark.parametrize(("ros", "status"), [("humble", 2), ("kilted", 3), ("", 3)])
def test_tests_of_a_release_need_a_shell_without_another_ros(
    releases: Path, ros: str, status: int
) -> None:
    shutil.copy(SCRIPTS / "test", releases / "scripts")
    (releases / "scripts" / "setup").write_text("#!/usr/bin/env bash\nexit 3\n")
    done = in_bash(f"ROS_DISTRO={ros} scripts/test --ros kilted", releases)
    assert done.returncode == status
    assert ("humble is not sourced" in done.stderr) == (status == 2)
