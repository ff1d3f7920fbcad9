"""The measurements of speed work; how fast it is, `scripts/bench` tells on a quiet machine."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from benchmarks import links, pages, scale, speed
from benchmarks.programs import running
from tests.harness import own_domain

#: As users of the JSON know them.
MEASURED = (
    *("service_rtt", "service_rtt_p99", "service_cpu", "concurrent"),
    *("push_latency", "push_cpu", "push_max"),
    *("convert_pose", "convert_scan", "convert_info"),
    *("idle_rss", "idle_cpu", "startup", "fleet"),
)


@pytest.mark.timeout(600)
def test_every_figure_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert speed.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert tuple(found) == MEASURED
    assert all(value > 0 for value in found.values()), found


@pytest.mark.timeout(600)
def test_every_link_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert links.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == list(links.LINKS)
    for figures in found.values():
        assert list(figures) == list(links.FIGURES)
        assert all(value > 0 for value in figures.values()), found


@pytest.mark.timeout(600)
def test_the_growth_of_cost_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert scale.main(["--smoke", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == list(scale.PLOTS)
    for curves in found.values():
        assert curves
        assert all(points for points in curves.values()), found


def test_a_program_that_dies_is_shown_with_what_it_said() -> None:
    with (
        pytest.raises(RuntimeError, match=r"ended with 1; it said:\n(?s:.*)ConnectionRefused"),
        own_domain() as domain,
        running("benchmarks.floors.websocket", "ws://127.0.0.1:1", domain=domain) as program,
    ):
        program.read()


def test_the_page_has_a_place_for_each_part() -> None:
    parts = re.findall(
        r"<!-- (\w+): made by [^\n]*-->\n(?s:.*?)<!-- end -->", pages.PAGE.read_text()
    )
    assert parts == ["figures", "links", *scale.PLOTS]


def test_a_part_is_put_into_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "speed.md"
    page.write_text("before\n<!-- figures: made by x -->\nold\n<!-- end -->\nafter\n")
    monkeypatch.setattr(pages, "PAGE", page)
    pages.write("figures", "new")
    assert page.read_text() == ("before\n<!-- figures: made by x -->\nnew\n<!-- end -->\nafter\n")
