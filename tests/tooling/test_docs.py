"""Names, numbers, examples and links in the docs match the code."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from tests.quick_chassis import quick_config
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.robot.readiness import pose_problem
from woosh_robot_agent.simulator import faults, load_scenario
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.command_line import make_parser
from woosh_robot_agent.simulator.protocol.reports import robot_info

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


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
