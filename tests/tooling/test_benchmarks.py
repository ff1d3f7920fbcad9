"""The benchmarks of speed work. `scripts/bench` measures the speed itself, on an idle machine."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks import (
    dashboard,
    fleet,
    links,
    maps,
    odom,
    page,
    real,
    recording,
    results,
    scale,
    setup,
    speed,
)
from benchmarks.__main__ import BENCHMARKS
from benchmarks.__main__ import main as bench
from benchmarks.measurements import large_pushes
from benchmarks.measurements.fleet import WAYS
from benchmarks.processes import ROOT, running
from benchmarks.programs.rosbridge import server_path
from woosh_robot_agent.testing import own_domain

pytestmark = pytest.mark.timeout(600)
"""Long, because each test starts many processes."""
FIGURES = (
    *("service_rtt", "service_rtt_p99", "service_cpu", "concurrent"),
    *("push_latency", "push_cpu", "push_max", "large_push"),
    *("cmd_vel_latency", "cmd_vel_cpu", "stop_latency", "goal_rtt", "nav2_goal_rtt", "scan_cpu"),
    *("convert_pose", "convert_scan", "convert_info"),
    *("map_download", "map_upload"),
    *("idle_rss", "idle_cpu", "startup"),
    *("nav2_idle_rss", "nav2_idle_cpu", "nav2_startup"),
    *("fleet_end", "fleet"),
)
"""Names in the output of `--speed --json`, which scripts of users may depend on."""


@pytest.fixture
def smoke(capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Function that runs a benchmark for seconds and returns its figures."""

    def run(benchmark: Any, *arguments: str) -> Any:
        assert benchmark.main(["--smoke", "--json", *arguments]) == 0
        return json.loads(capsys.readouterr().out)

    return run


def not_positive(figures: dict[str, float]) -> dict[str, float]:
    """Return the figures that are zero, negative or NaN."""
    return {name: value for name, value in figures.items() if not value > 0}


def test_the_names_of_the_figures_stay() -> None:
    assert (*FIGURES, "rosbridge") == tuple(speed.TARGETS)


_VARIANTS = {"nav2_goal_rtt", "nav2_idle_rss", "nav2_idle_cpu", "nav2_startup", "fleet_end"}
"""Figures of another interface or number of nodes, from code that measures another figure, too."""
_MEASURED_BELOW = {"fleet", "map_download", "map_upload"}


def test_figures_of_each_kind_are_measured(smoke, monkeypatch):
    monkeypatch.setattr(large_pushes, "_POSES", 6_000)
    wanted = [name for name in FIGURES if name not in _VARIANTS | _MEASURED_BELOW]
    optional = ["rosbridge"] if server_path() else []
    found = smoke(speed, "--only", *wanted, *optional)
    assert list(found) == wanted + optional
    assert not not_positive(found)


def test_maps_are_measured_over_a_link(smoke, monkeypatch):
    name = next(iter(links.LINKS))
    monkeypatch.setattr(links, "LINKS", {name: links.LINKS[name]})
    found = smoke(maps)
    assert list(found) == [name, maps.FLOOR]
    assert list(found[name]) == list(maps.FIGURES)
    for figures in found.values():
        assert all("memory" in name for name in not_positive(figures)), not_positive(figures)


def test_a_curve_of_scale_is_measured(smoke):
    found = smoke(scale, "--only", "robots")
    assert list(found["robots"]) == list(WAYS)
    assert all(found["robots"].values()), found


def test_odom_is_measured(smoke):
    found = smoke(odom)
    assert list(found) == [odom.ODOM, odom.REPORTS, odom.LAST, "times"]
    for figures in found.values():
        assert not not_positive(figures)


def test_the_dashboard_is_measured(smoke, monkeypatch):
    monkeypatch.setattr(dashboard, "_TURNS", 1)
    found = smoke(dashboard)
    in_browser = {
        "load": ["bytes", "seconds"],
        "frames": ["rate", "busy"],
        "hour": ["begin", "begin_nodes", "end", "end_nodes"],
    }
    assert list(found) == ["1", "10", "link", *(in_browser if page.is_available() else ())]
    assert list(found["link"]) == ["alone", "watched", "alone_p99", "watched_p99"]
    for name, figures in found.items():
        wanted = in_browser.get(name, ["cpu", "traffic", "scans"])
        assert figures is found["link"] or list(figures) == wanted
        assert not not_positive(figures)


def test_recordings_are_measured_and_complete(smoke):
    found = smoke(recording)
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


@pytest.mark.skipif(fleet.mosquitto_path() is None, reason="mosquitto is not installed")
def test_vda5050_vehicles_are_measured(smoke):
    found = smoke(fleet)
    assert [each["robots"] for each in found] == [2]
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


def test_simulated_chassis_is_like_the_real_robot(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(real, "_SEEDS", range(1))
    assert bench(["--real", "--smoke"]) == 0
    printed = capsys.readouterr().out
    assert "| Rates and driving | Real robot | Simulated |" in printed
    assert "**differs**" not in printed


def test_difference_from_the_real_robot_is_reported() -> None:
    facts = real.real_robot()
    facts["times"]["navigation to wait"] = 0.8
    times = {name: [0.5] for name in real.real_times()}
    figures = {figure.name: figure for figure in real.time_figures(facts, times)}
    assert not figures["navigation to wait"].ok
    assert figures["answer to first report"].ok
    assert "**differs**" in real.tables([("Times", list(figures.values()))])


def test_results_are_saved_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def run() -> int:
        print("| a table |")
        return 1

    assert results.save("odom", "error of odom", ["--profile", "s"], run, tmp_path) == 1
    assert capsys.readouterr().out == "| a table |\n"
    (page,) = tmp_path.rglob("odom.md")
    text = page.read_text()
    assert text.startswith("# Error of odom\n\n`scripts/bench --odom --profile s` on 20")
    assert "rclpy" in text
    assert text.endswith("\n\n| a table |\n")


def test_figures_without_a_meaning_are_not_saved(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        bench(["--odom", "--save", "--smoke"])
    assert ended.value.code == 2
    assert "--save cannot be combined with --smoke" in capsys.readouterr().err


def test_figures_in_the_documentation_are_measured() -> None:
    page = (ROOT / "docs/speed.md").read_text()
    named = re.findall(r"^\| `(\w+)` \|", page, re.M)
    assert named
    assert set(named) <= set(speed.TARGETS)
    for link in re.findall(r"scripts/bench --(\w+)", page):
        assert link in BENCHMARKS
    assert {page.stem for page in results.RESULTS.rglob("*.md")} <= BENCHMARKS.keys()
