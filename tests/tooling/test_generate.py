"""Generated files and tables are up to date."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from scripts import generate
from woosh_robot_agent.endpoints import minimum_timeouts

ROOT = Path(__file__).parents[2]


def test_generated_files_are_up_to_date() -> None:
    stale = [str(path.relative_to(ROOT)) for path, _ in generate.outdated(ROOT)]
    assert not stale, f"out of date: {', '.join(stale)}; run {generate.COMMAND}"


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: Any) -> Path:
    """A copy of what is generated and of its sources, which `generate.main` works on."""
    for name in ("README.md", "setup.py", "tests/facts/status_codes.yaml", *generate.FILES):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for folder in ("docs", "proto", *(path.name for path in ROOT.glob("woosh_*_msgs"))):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    monkeypatch.setattr(generate, "ROOT", tmp_path)
    return tmp_path


def test_interface_files_are_written_and_removed(checkout: Path, capsys: Any) -> None:
    lost = checkout / "woosh_ros_msgs/action/MoveBase.action"
    changed = checkout / "woosh_nav_msgs/msg/Path.msg"
    old = checkout / "woosh_map_msgs/srv/Old.srv"
    before = {path: path.read_bytes() for path in (lost, changed)}
    lost.unlink()
    changed.write_text("uint8 other\n")
    old.write_text("---\n")

    assert generate.main(["--check"]) == 1
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == [
        "woosh_nav_msgs/msg/Path.msg",
        "woosh_ros_msgs/action/MoveBase.action",
        "woosh_map_msgs/srv/Old.srv",
    ]
    assert changed.read_text() == "uint8 other\n"

    assert generate.main([]) == 0
    assert {path: path.read_bytes() for path in before} == before
    assert not old.exists()
    assert generate.main(["--check"]) == 0


def test_a_faulty_schema_is_reported(checkout: Path, capsys: Any) -> None:
    (checkout / "proto/woosh/proto/broken.proto").write_text('syntax = "proto3";\nmessage\n')

    with pytest.raises(SystemExit) as ended:
        generate.main([])

    assert ended.value.code == 2
    assert re.search(r"do not compile: \S*/broken\.proto:", capsys.readouterr().err)


def test_each_table_has_a_place() -> None:
    text = "\n".join(page.read_text() for page in generate.pages(ROOT))
    assert set(re.findall(r"^<!-- generated: (\S+) -->$", text, re.M)) == set(generate.TABLES)


def test_each_minimum_timeout_has_a_row() -> None:
    rows = "\n".join(page.read_text() for page in generate.pages(ROOT)).splitlines()
    for request, timeout in minimum_timeouts().items():
        cells = f"| {request} | {timeout:g} s |"
        assert any(row.startswith("| ") and cells in row for row in rows), request
