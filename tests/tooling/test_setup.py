"""Parts of scripts/setup: settings of uv, progress, releases of ROS; the help of the scripts."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


def uv_settings(settings_of_pip: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, SCRIPTS / "uv_settings"],
        env={name: value for name, value in os.environ.items() if not name.startswith("UV_")},
        input=settings_of_pip,
        capture_output=True,
        text=True,
    )


def test_uv_gets_the_settings_of_pip() -> None:
    settings = """\
:env:.find-links='/wheels /more wheels'
:env:.proxy='user:\\'"word@proxy:80'
global.extra-index-url='https://one/simple\\nfile:///two'
global.index-url='https://global/simple'
install.index-url="https://it's/simple"
"""
    variables = dict(line.split("=", 1) for line in uv_settings(settings).stdout.splitlines())
    assert variables["UV_DEFAULT_INDEX"] == "https://it's/simple"
    assert variables["UV_INDEX"] == "https://one/simple file:///two"
    assert variables["UV_FIND_LINKS"] == "/wheels,/more,wheels"
    assert variables["ALL_PROXY"] == "user:'\"word@proxy:80"


@pytest.mark.parametrize(("value", "status"), [("1", 1), ("false", 0)])
def test_uv_is_not_used_if_pip_may_ask_no_index(value: str, status: int) -> None:
    assert uv_settings(f"install.no-index='{value}'\n").returncode == status


def progress_of(script: str) -> subprocess.Popen[str]:
    """Start a script that prints its progress every 0.05 s."""
    return subprocess.Popen(
        ["bash", "-c", script],
        env=os.environ | {"WOOSH_PROGRESS_INTERVAL": "0.05"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_a_long_step_tells_how_far_it_is(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("first\nDownloading scipy (33 MB)\n")
    script = f". {SCRIPTS}/progress; progress_start last_line {log}; cat; progress_stop"
    with progress_of(script) as step:
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
    with progress_of(script) as step:
        assert step.stdout
        step.stdout.readline()
        step.kill()
        step.stdout.read()  # ends, although nobody has waited for the script yet


@pytest.fixture
def releases(tmp_path: Path) -> Path:
    """A checkout, with a space in its path, in which Jazzy and Kilted have been set up."""
    root = tmp_path / "a checkout"
    (root / "scripts").mkdir(parents=True)
    for name in ("setup", "env", "progress", "versions.txt"):
        shutil.copy(SCRIPTS / name, root / "scripts")
    (root / "bin").mkdir()
    (root / "bin" / "apt-get").symlink_to("/bin/false")
    (root / "bin" / "uname").write_text("#!/usr/bin/env bash\necho ${MACHINE:-x86_64}\n")
    (root / "bin" / "uname").chmod(0o755)
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


def test_ros_from_pypi_needs_x86_64(releases: Path) -> None:
    done = in_bash("MACHINE=aarch64 scripts/setup", releases)
    assert done.returncode == 1
    assert "for x86_64 only, and this is aarch64" in done.stderr


def test_caches_that_cannot_be_written_are_moved(releases: Path) -> None:
    script = """
    hash=$(sha256sum scripts/setup scripts/versions.txt | sha256sum)
    echo "$PWD pypi jazzy  $hash" >build/setup/environment
    XDG_CACHE_HOME=/proc scripts/setup
    """
    done = in_bash(script, releases)
    assert "not writable" in done.stdout
    assert f"XDG_CACHE_HOME={releases}/build/cache\n" in done.stderr


@pytest.mark.parametrize(("ros", "status"), [("humble", 2), ("kilted", 3)])
def test_tests_of_a_release_need_a_shell_without_another_ros(releases, ros, status):
    shutil.copy(SCRIPTS / "test", releases / "scripts")
    (releases / "scripts" / "setup").write_text("#!/usr/bin/env bash\nexit 3\n")
    done = in_bash(f"ROS_DISTRO={ros} scripts/test --ros kilted", releases)
    assert done.returncode == status
    assert ("humble is not sourced" in done.stderr) == (status == 2)


@pytest.mark.parametrize("name", ["deb", "run", "setup"])
def test_a_script_explains_itself(name: str) -> None:
    def output(option: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([f"./{name}", option], cwd=SCRIPTS, capture_output=True, text=True)

    help_asked = output("--help")
    assert f"scripts/{name}" in help_asked.stdout
    unknown = output("--fast")
    assert unknown.returncode == 2
    assert unknown.stderr == f"unknown argument: --fast\n{help_asked.stdout}"
