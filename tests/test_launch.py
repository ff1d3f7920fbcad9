"""Launch files and configuration: what they start exists, and takes what they give it."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

pytest.importorskip("rclpy")

import launch_stub
from ament_index_python.packages import PackageNotFoundError

from woosh_robot_agent import parameters
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.standard.table import BY_NAME

ROOT = Path(__file__).parent.parent
PACKAGE = "woosh_robot_agent"
EXECUTABLES = {"agent", "simulator"}


@pytest.fixture
def share(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where launch files find the package: here, whatever is installed."""
    import ament_index_python.packages as packages

    def share(name: str) -> str:
        if name != PACKAGE:
            raise PackageNotFoundError(name)
        return str(ROOT)

    monkeypatch.setattr(packages, "get_package_share_directory", share)
    monkeypatch.setattr(packages, "get_package_prefix", share)
    return ROOT


class Launch:
    """A launch file that was read, with what it starts for some arguments."""

    def __init__(self, name: str, seen: dict[str, Any] | None = None, **given: str) -> None:
        with launch_stub.installed():
            path = ROOT / "launch" / f"{name}.launch.py"
            self.description = runpy.run_path(str(path))["generate_launch_description"]()
            # an included file shares what those before it were given and declared
            self.context: dict[str, Any] = {} if seen is None else seen
            self.context |= given
            self.started: list[Any] = []
            self.declared: set[str] = set()
            for part in self.description.arguments[0]:
                self._take(part, given)
        assert set(given) <= self.declared, "an argument that the file does not declare"

    def _take(self, part: Any, given: dict[str, str]) -> None:
        kind = type(part).__name__
        if kind == "DeclareLaunchArgument":
            name = part.arguments[0]
            assert part.description
            self.declared.add(name)
            if name not in self.context:
                self.context[name] = launch_stub.resolve(part.default_value, self.context)
        elif kind == "OpaqueFunction":
            self.started += part.function(self.context)
        else:
            self.started.append(part)

    def nodes(self) -> list[dict[str, Any]]:
        """Every node with its parameters resolved."""
        found = []
        for part in self.started:
            if type(part).__name__ == "Node":
                values: dict[str, Any] = {}
                files = []
                for each in part.parameters:
                    each = launch_stub.resolve(each, self.context)
                    if isinstance(each, dict):
                        values |= {k: launch_stub.resolve(v, self.context) for k, v in each.items()}
                    else:
                        files.append(each)
                found.append(
                    {
                        "executable": (part.package, part.executable),
                        "namespace": launch_stub.resolve(part.namespace, self.context),
                        "values": values,
                        "files": files,
                    }
                )
        return found

    def agents(self) -> list[dict[str, Any]]:
        """The agents that included files start; each is read as soon as it is included."""
        found = []
        for part in self.started:
            if type(part).__name__ == "IncludeLaunchDescription":
                found += self._include(part).nodes()[:1]
        return found

    def included(self) -> list[Launch]:
        """The launch files that it includes, with the arguments that it gives them, one by one."""
        return [
            self._include(part)
            for part in self.started
            if type(part).__name__ == "IncludeLaunchDescription"
        ]

    def _include(self, part: Any) -> Launch:
        path = Path(part.arguments[0].arguments[0])
        assert path.exists()
        given = {
            key: launch_stub.resolve(value, self.context) for key, value in part.launch_arguments
        }
        return Launch(path.name.removesuffix(".launch.py"), self.context, **given)


def check_agent(node: dict[str, Any]) -> dict[str, Any]:
    """The parameters are the agent's, and make sense together; returns all of them."""
    assert node["executable"] == (PACKAGE, "agent")
    values = {p.name: p.initial for p in parameters.PARAMETERS}
    for file in node["files"]:
        values |= yaml.safe_load(Path(file).read_text())["/**"]["ros__parameters"]
    values |= node["values"]
    parameters.check(values)
    return values


@pytest.mark.usefixtures("share")
class TestLaunch:
    def test_agent(self):
        (node,) = Launch("agent", ip="172.20.8.74", namespace="robot7").nodes()
        values = check_agent(node)
        assert (values["ip"], node["namespace"]) == ("172.20.8.74", "robot7")

    def test_bringup_without_a_publisher_of_models(self):
        (node,) = Launch("bringup", ip="172.20.8.74", frame_prefix="r1/").nodes()
        values = check_agent(node)
        assert values["publish_tf"] is True
        assert values["publish_laser_tf"] is True
        assert values["frame_prefix"] == "r1/"

    def test_bringup_with_one(self, monkeypatch: pytest.MonkeyPatch):
        import ament_index_python.packages as packages

        monkeypatch.setattr(packages, "get_package_prefix", lambda _name: "/opt/ros/jazzy")
        agent, model = Launch("bringup", ip="172.20.8.74", frame_prefix="r1/").nodes()
        assert check_agent(agent)["publish_laser_tf"] is False
        assert model["executable"] == ("robot_state_publisher",) * 2
        assert model["values"]["frame_prefix"] == "r1/"
        assert "<robot" in model["values"]["robot_description"]

    def test_sim(self):
        launch = Launch("sim", port="5490", speed="2")
        (simulator,) = [p for p in launch.started if type(p).__name__ == "ExecuteProcess"]
        path, *arguments = [launch_stub.resolve(each, launch.context) for each in simulator.cmd]
        assert Path(path).name in EXECUTABLES
        assert arguments == ["--port", "5490", "--tcp-port", "0", "--speed", "2"]
        (bringup,) = launch.included()
        values = check_agent(bringup.nodes()[0])
        assert (values["ip"], values["port"]) == ("127.0.0.1", 5490)

    def test_fleet(self):
        agents = [check_agent(each) for each in Launch("fleet").agents()]
        assert [(v["port"], v["frame_prefix"]) for v in agents] == [(5480, "r1/"), (5490, "r2/")]

    def test_robots_of_a_fleet_do_not_inherit_from_each_other(self, tmp_path: Path):
        file = tmp_path / "fleet.yaml"
        own = tmp_path / "own.yaml"
        own.write_text("/**: {ros__parameters: {poll_timeout: 1234}}")
        robots = f"[{{name: r1, ip: a, port: 5490, params_file: {own}}}, {{name: r2, ip: b}}]"
        file.write_text(f"robots: {robots}")
        first, second = (check_agent(each) for each in Launch("fleet", robots=str(file)).agents())
        assert (first["port"], first["poll_timeout"]) == (5490, 1234)
        assert (second["port"], second["poll_timeout"]) == (0, 10000)

    def test_what_is_not_given_leaves_the_file_alone(self, tmp_path: Path):
        file = tmp_path / "own.yaml"
        file.write_text("/**: {ros__parameters: {ip: a, port: 7, frame_prefix: r3/}}")
        for name in ("agent", "bringup"):
            (node,) = Launch(name, params_file=str(file)).nodes()
            values = check_agent(node)
            assert (values["ip"], values["port"], values["frame_prefix"]) == ("a", 7, "r3/")

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "robots: {}",
            "robots: [{name: r1}]",
            "robots: [{name: r1, ip: a, colour: red}]",
            "robots: [{name: r1, ip: a}, {name: r1, ip: b}]",
        ],
    )
    def test_a_fleet_that_makes_no_sense(self, text: str, tmp_path: Path):
        file = tmp_path / "fleet.yaml"
        file.write_text(text)
        with pytest.raises(ValueError, match=r"fleet\.yaml"):
            Launch("fleet", robots=str(file))


class TestConfiguration:
    def test_the_parameter_file_has_them_all(self):
        assert (ROOT / "config/agent.yaml").read_text() == parameters.yaml()

    def test_the_model(self):
        robot = ElementTree.parse(ROOT / "config/woosh_base.urdf").getroot()
        links = {link.get("name") for link in robot.iter("link")}
        assert {"base_link", "laser"} <= links
        for joint in robot.iter("joint"):
            assert {joint.find("parent").get("link"), joint.find("child").get("link")} <= links  # type: ignore[union-attr]

    def test_rviz_shows_what_there_is(self):
        config = yaml.safe_load((ROOT / "config/woosh.rviz").read_text())
        self._are_topics(_values(config, "Value", starting="/woosh_robot/"))

    def test_foxglove_shows_what_there_is(self):
        layout = json.loads((ROOT / "config/foxglove_layout.json").read_text())
        self._are_topics(_values(layout, None, starting="/woosh_robot/"))

    @staticmethod
    def _are_topics(paths: set[str]) -> None:
        known = {*BY_NAME, *(topic.name for topic in TOPICS)}
        shown = {path.removeprefix("/woosh_robot/").split(".")[0] for path in paths}
        assert len(shown) >= 4
        # RViz may listen to what only the model's publisher sends
        assert shown <= known | {"robot_description"}


def _values(tree: Any, key: str | None, starting: str) -> set[str]:
    """Every text below `key`, or anywhere, that begins with `starting`."""
    found: set[str] = set()
    if isinstance(tree, dict):
        for name, value in tree.items():
            if isinstance(name, str) and key is None and name.startswith(starting):
                found.add(name)
            if isinstance(value, str):
                if (key is None or name == key) and value.startswith(starting):
                    found.add(value)
            else:
                found |= _values(value, key, starting)
    elif isinstance(tree, list):
        for value in tree:
            found |= (
                {value}
                if isinstance(value, str) and key is None and value.startswith(starting)
                else _values(value, key, starting)
            )
    return found
