"""Names, numbers, layers, phases, examples and links in the docs match the code."""

from __future__ import annotations

import ast
import re
import shlex
import sys
from functools import cache
from pathlib import Path
from typing import Any

from tests.quick_chassis import quick_config
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.robot.readiness import pose_problem
from woosh_robot_agent.ros.actions.goal import TRANSITIONS
from woosh_robot_agent.simulator import faults, load_scenario
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.command_line import make_parser
from woosh_robot_agent.simulator.protocol.reports import robot_info

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
ARCHITECTURE = DOCS / "architecture.md"


def test_the_simulators_examples_are_valid(tmp_path: Path) -> None:
    text = (DOCS / "simulator.md").read_text()
    scenarios = re.findall(r"```yaml\n# scenario\n(.*?)```", text, re.S)
    assert scenarios
    for scenario in scenarios:
        file = tmp_path / "scenario.yaml"
        file.write_text(scenario)
        assert load_scenario(file).steps
    commands = re.findall(r'--fault "([^"]+)"', text)
    assert commands
    for command in commands:
        faults.parse_fault(command)
    lines = [
        line
        for block in re.findall(r"```bash\n(.*?)```", text, re.S)
        for line in block.replace("\\\n", "").splitlines()
    ]
    assert any("--fault" in line for line in lines)
    for line in lines:
        words = shlex.split(line, comments=True)
        if words[:4] == ["ros2", "run", "woosh_robot_agent", "simulator"]:
            make_parser().parse_args(words[4:])
        else:
            assert words[0] == "python3" or words[0].startswith("scripts/"), line
    injected = re.findall(r'\.inject\(\s*"(\w+)"', text)
    assert set(injected) <= set(faults.FAULTS)


def test_the_documented_scene_matches_the_simulator(tmp_path: Path) -> None:
    (scene,) = re.findall(
        r"```yaml\n# scene\n(.*?)```", (DOCS / "simulator.md").read_text(), re.DOTALL
    )
    (tmp_path / "scene.yaml").write_text(scene)
    chassis = Chassis(quick_config(scenes=(tmp_path,)))
    assert chassis.scene.name == "lab"
    assert set(chassis.map.marks) == {"A1", "P1"}
    assert pose_problem(robot_info(chassis)) is None


def test_the_documented_limits_match_the_code() -> None:
    text = (DOCS / "security.md").read_text()
    simulator, link = quick_config(), LinkConfig()
    for said in (
        f"`--max-frame` ({simulator.max_frame >> 20} MiB)",
        f"`--max-waiting` ({simulator.max_waiting})",
        f"`--max-outbox` ({simulator.max_outbox:,})".replace(",", " "),
        f"`--max-connections` ({simulator.max_connections})",
        f"The simulator listens on {simulator.host}.",
        f"`max_frame_size` bytes ({link.max_frame_size >> 20} MiB)",
        f"At most {link.max_in_flight} requests",
        f"up to {link.backoff_max:g} s",
    ):
        assert said in text, said


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_between_pages_have_targets() -> None:
    for page in (*DOCS.glob("*.md"), ROOT / "README.md", ROOT / "benchmarks/README.md"):
        for target, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", page.read_text()):
            linked = (page.parent / target) if target else page
            assert linked.exists(), (page, target)
            assert not anchor or anchor in anchors(linked), (page, f"{target}#{anchor}")


def contracts() -> list[dict[str, Any]]:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    found: list[dict[str, Any]] = settings["tool"]["importlinter"]["contracts"]
    return found


def documented_layers() -> list[set[str]]:
    """The modules in each row of the table of layers, from top to bottom."""
    table = ARCHITECTURE.read_text().partition("## Layers")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    return [set(re.findall(r"`(\w+)/?`", row)) for row in rows]


def test_the_page_lists_the_layers_of_the_contract() -> None:
    (layers,) = (each["layers"] for each in contracts() if each.get("id") == "layers")
    assert documented_layers() == [set(re.findall(r"\w+", layer)) for layer in layers]


def test_no_contract_ignores_an_import() -> None:
    assert not [each["name"] for each in contracts() if each.get("ignore_imports")]


EDGE = re.compile(r"^ +(\[\*\]|\w+) --> (\[\*\]|\w+)(?:: (.+))?$")


def test_diagram_shows_the_transitions_of_a_goal_and_its_first_and_last_phase() -> None:
    found = re.search(r"```mermaid\nstateDiagram-v2\n(.*?)```", ARCHITECTURE.read_text(), re.S)
    assert found
    lines = [EDGE.match(line) for line in found[1].splitlines()]
    assert all(lines)
    edges = [(line[1], line[2], line[3] or "") for line in lines if line]
    inner = {(before.name, after.name, step.value) for (before, step), after in TRANSITIONS.items()}
    assert sorted(edges) == sorted([("[*]", "NEW", ""), *inner, ("ENDED", "[*]", "")])


# docs/safety.md

SAFETY = (DOCS / "safety.md").read_text()


@cache
def names_in(file: Path) -> set[str]:
    """Return the names of the tests in a file as in pytest's ids: `name` or `Class::name`."""
    found = set()
    for node in ast.parse(file.read_text()).body:
        members = node.body if isinstance(node, ast.ClassDef) else [node]
        prefix = f"{node.name}::" if isinstance(node, ast.ClassDef) else ""
        for member in members:
            if isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef):
                found.add(prefix + member.name)
    return found


def test_each_test_that_a_rule_names_exists() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::([\w:]+)`", SAFETY)
    assert len(named) > 20
    for path, name in named:
        assert name.startswith("test_") or "::test_" in name
        assert name in names_in(ROOT / path), f"{path}::{name}"


def test_each_rule_names_a_test() -> None:
    rules = re.findall(r"^- \*\*\d+\.\d+\*\* .*\n(?:  .*\n)+", SAFETY, re.M)
    assert len(rules) == len(re.findall(r"^- ", SAFETY, re.M)) > 10
    assert not [rule for rule in rules if "tests/" not in rule]
