"""The benchmarks of speed work. `scripts/bench` measures the speed itself, on an idle machine."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks.measurements.vehicles import mosquitto_path
from benchmarks.processes import running
from benchmarks.programs import rosbridge_server
from benchmarks.report import (
    dashboard,
    fleet,
    links,
    maps,
    odom,
    pages,
    real,
    recording,
    scale,
    setup,
    speed,
)
from woosh_robot_agent.testing import own_domain

pytestmark = pytest.mark.timeout(600)
"""Long, because each test starts many processes."""
FIGURES = (
    *("service_rtt", "service_rtt_p99", "service_cpu", "concurrent"),
    *("push_latency", "push_cpu", "push_max", "large_push"),
    *("cmd_vel_latency", "cmd_vel_cpu", "stop_latency", "goal_rtt", "scan_cpu"),
    *("convert_pose", "convert_scan", "convert_info"),
    *("map_download", "map_upload"),
    *("idle_rss", "idle_cpu", "startup", "fleet_end", "fleet"),
)
"""Names in the output of `--speed --json`, which scripts of users may depend on."""


def not_positive(figures: dict[str, float]) -> dict[str, float]:
    """Return the figures that are zero, negative or NaN."""
    return {name: value for name, value in figures.items() if not value > 0}


def test_every_figure_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert speed.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    optional = ("rosbridge",) if rosbridge_server.executable() else ()
    assert tuple(found) == FIGURES + optional
    assert not not_positive(found)


def test_every_link_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert links.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == list(links.LINKS)
    for figures in found.values():
        assert list(figures) == list(links.FIGURES)
        assert not not_positive(figures)


def test_maps_are_measured_over_every_link(capsys: pytest.CaptureFixture[str]) -> None:
    assert maps.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == [*links.LINKS, maps.FLOOR]
    for name in links.LINKS:
        assert list(found[name]) == list(maps.FIGURES)
    for figures in found.values():
        assert all("memory" in name for name in not_positive(figures)), not_positive(figures)


def test_every_curve_of_scale_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert scale.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == list(scale.SWEEPS)
    for curves in found.values():
        assert curves
        assert all(points for points in curves.values()), found


def test_odom_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert odom.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == [odom.ODOM, odom.REPORTS, odom.LAST, "times"]
    for figures in found.values():
        assert not not_positive(figures)


def test_the_dashboard_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert dashboard.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["1", "10", "link"]
    assert list(found["link"]) == ["alone", "watched", "alone_p99", "watched_p99"]
    for figures in found.values():
        assert figures is found["link"] or list(figures) == ["cpu", "traffic", "scans"]
        assert not not_positive(figures)


def test_recordings_are_measured_and_complete(capsys: pytest.CaptureFixture[str]) -> None:
    assert recording.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == [
        recording.PROXY_FLOOR,
        recording.PROXY,
        recording.CLIENT_FLOOR,
        recording.ALONE,
    ]
    assert all(figures["cpu"] > 0 for figures in found.values()), found
    for name in (recording.PROXY, recording.ALONE):
        assert found[name]["lost"] == 0
        assert found[name]["size"] > 0


def test_set_up_is_measured_with_empty_and_with_filled_caches(tmp_path: Path) -> None:
    repository = tmp_path / "repository"
    script = repository / "scripts/setup"
    script.parent.mkdir(parents=True)
    log = tmp_path / "log"
    script.write_text(
        f'#!/bin/sh\ncat "$CCACHE_DIR" "$XDG_CACHE_HOME/idl" >>{log} 2>/dev/null && exit\n'
        f'mkdir -p "$XDG_CACHE_HOME" && echo filled | tee "$CCACHE_DIR" >"$XDG_CACHE_HOME/idl"\n'
    )
    script.chmod(0o755)
    for command in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "-m", "test"]):
        subprocess.run(
            ["git", "-c", "user.name=t", "-c", "user.email=t@t", *command],
            cwd=repository,
            check=True,
        )
    assert list(setup.measure(repository)) == ["setup", "setup_again"]
    assert log.read_text() == "filled\nfilled\n"


@pytest.mark.skipif(mosquitto_path() is None, reason="mosquitto is not installed")
def test_vda5050_vehicles_are_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert fleet.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [each["robots"] for each in found] == [1, 2]
    for figures in found:
        assert figures["lost"] == 0
        assert figures["ended"] == figures["robots"]
        assert all(figures[name] > 0 for name in ("measured", "messages", "cpu", "rss")), figures


def test_error_of_a_program_that_dies_holds_its_log() -> None:
    with (
        pytest.raises(RuntimeError, match=r"ended with status 1(?s:.*)ConnectionRefused"),
        own_domain() as domain,
        running("benchmarks.floors.websocket", "ws://127.0.0.1:1", domain=domain) as program,
    ):
        program.receive()


def test_page_has_a_place_for_each_part() -> None:
    parts = re.findall(
        r"<!-- (\w+): made by [^\n]*-->\n(?s:.*?)<!-- end -->", pages.SPEED_PAGE.read_text()
    )
    assert parts == ["figures", "setup", "links", "maps", *scale.SWEEPS]


def test_part_of_the_page_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "speed.md"
    page.write_text("before\n<!-- figures: made by x -->\nold\n<!-- end -->\nafter\n")
    monkeypatch.setattr(pages, "SPEED_PAGE", page)
    pages.write_part("figures", "new")
    assert page.read_text() == "before\n<!-- figures: made by x -->\nnew\n<!-- end -->\nafter\n"


def test_simulated_chassis_is_like_the_real_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "simulator.md"
    page.write_text("before\n<!-- real: made by x -->\nold\n<!-- end -->\nafter\n")
    monkeypatch.setattr(real, "SIMULATOR_PAGE", page)
    monkeypatch.setattr(real, "SEEDS", range(2))
    monkeypatch.setattr(real, "ANSWERS", 100)
    assert real.main(["--docs"]) == 0
    written = page.read_text()
    assert "| Rates and driving | Real robot | Simulated |" in written
    assert "old" not in written
    assert "**differs**" not in written


def test_difference_from_the_real_robot_is_reported() -> None:
    facts = real.real_robot()
    facts["times"]["navigation to wait"] = 0.8
    times = {name: [0.5] for name in real.real_times()}
    figures = {figure.name: figure for figure in real.time_figures(facts, times)}
    assert not figures["navigation to wait"].ok
    assert figures["answer to first report"].ok
    assert "**differs**" in real.tables([("Times", list(figures.values()))])
