"""The service, the files of the Debian package, the release notes, and the files for GitHub.

`scripts/deb --test` installs and runs the package itself.
"""

from __future__ import annotations

import configparser
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
UNIT = ROOT / "config/woosh-robot-agent.service"
DEBIAN = ROOT / "scripts/debian"
GITHUB = ROOT / ".github"


def service() -> dict[str, str]:
    """Return the settings of the service; of those that occur several times, the last one."""
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(UNIT.read_text().replace("\\\n", " "))
    return dict(parser["Service"])


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="there is no systemd-analyze")
def test_systemd_accepts_the_service(tmp_path: Path) -> None:
    unit = tmp_path / UNIT.name
    # The program exists only where the package is installed.
    unit.write_text(re.sub(r"(?m)^(ExecStart=)\S+", r"\1/bin/true", UNIT.read_text()))
    verified = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True
    )
    assert unit.stem not in verified.stderr, verified.stderr
    assert verified.returncode == 0, verified.stderr


def test_the_package_installs_what_the_service_uses() -> None:
    installed = {
        f"/{folder}/{Path(file).name}"
        for file, folder in (
            line.split() for line in (DEBIAN / "woosh-robot-agent.install").read_text().splitlines()
        )
    }
    command = shlex.split(service()["ExecStart"])
    assert command[0] in installed
    assert command[command.index("--params-file") + 1] in installed
    assert service()["EnvironmentFile"].removeprefix("-") in installed
    users = (DEBIAN / "woosh-robot-agent.sysusers").read_text()
    assert re.search(rf"(?m)^u {service()['User']} ", users)
    for variable in re.findall(r"\$\{(\w+)\}", service()["ExecStart"]):
        assert re.search(rf"(?m)^{variable}=", (DEBIAN / "agent.env").read_text())


def test_the_parameters_of_the_service_exist_and_are_the_defaults() -> None:
    def parameters(file: Path) -> dict[str, Any]:
        content: dict[str, Any] = yaml.safe_load(file.read_text())["/**"]["ros__parameters"]
        return content

    ours = parameters(DEBIAN / "agent.yaml")
    assert ours.items() <= parameters(ROOT / "config/agent.yaml").items()
    assert {"ip", "observe_only"} <= ours.keys()


def release_notes(version: str) -> subprocess.CompletedProcess[str]:
    """Run `scripts/release_notes`."""
    return subprocess.run([ROOT / "scripts/release_notes", version], capture_output=True, text=True)


def test_the_release_notes_are_a_section_of_the_changelog(tmp_path: Path) -> None:
    notes = release_notes("0.1.0")
    assert notes.returncode == 0
    assert notes.stdout.startswith("The first release.")
    assert notes.stdout.rstrip("\n") in (ROOT / "CHANGELOG.md").read_text()

    script = tmp_path / "scripts/release_notes"
    script.parent.mkdir()
    shutil.copy(ROOT / "scripts/release_notes", script)
    (tmp_path / "CHANGELOG.md").write_text(
        "# Changelog\n\n## [Unreleased]\n\n## [1.1.0] - 2026-01-02\n\n- New.\n\n"
        "## [1.0.0]\n\n- Old.\n"
    )
    run = subprocess.run([script, "1.1.0"], capture_output=True, text=True, check=True)
    assert run.stdout == "- New.\n"
    assert subprocess.run([script, "Unreleased"], capture_output=True).returncode == 1
    missing = release_notes("999.0")
    assert (missing.returncode, missing.stdout) == (1, "")
    assert "[999.0]" in missing.stderr


def test_the_scripts_of_the_workflows_exist() -> None:
    for file in (GITHUB / "workflows").iterdir():
        text = file.read_text()
        used = re.findall(r"(?<![\w/])(?:scripts|\.ci)/\w+\b(?!\.)", text)
        assert used, file
        for script in used:
            assert (ROOT / script).is_file(), (file, script)
        jobs = yaml.safe_load(text)["jobs"]
        assert {each["needs"] for each in jobs.values() if "needs" in each} <= set(jobs), file
