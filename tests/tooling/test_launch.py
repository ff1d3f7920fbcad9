"""Launch files and configuration: what they name exists, and their parameters are accepted."""

from __future__ import annotations

import re
import runpy
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

pytest.importorskip("rclpy")

import rclpy
from ament_index_python.packages import PackageNotFoundError
from rclpy.context import Context

from tests.tooling import launch_stub
from woosh_robot_agent import parameters
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.ros.standard_endpoints import STANDARD

ROOT = Path(__file__).parents[2]
PACKAGE = "woosh_robot_agent"
EXECUTABLES = {"agent", "simulator"}


@pytest.fixture
def share(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Let launch files find the package in this checkout; return its folder."""
    import ament_index_python.packages as packages

    def share(name: str) -> str:
        if name != PACKAGE:
            raise PackageNotFoundError(name)
        return str(ROOT)

    monkeypatch.setattr(packages, "get_package_share_directory", share)
    monkeypatch.setattr(packages, "get_package_prefix", share)
    return ROOT


class Launch:
    """A launch file, evaluated with some arguments.

    Args:
        name: name of the file, without its suffix.
        context: the launch configurations. As in ROS 2, all files share them: arguments that an
            included file gets or declares are also seen by what follows.
        given: the file's launch arguments.

    Attributes:
        given: the file's launch arguments.
        declared: names of the launch arguments that it declares.
        nodes: the nodes that it starts, with resolved parameters.
        included: the launch files that it includes.
        messages: texts that it logs.
        others: everything else that it starts.
    """

    def __init__(self, name: str, context: launch_stub.Context | None = None, **given: str) -> None:
        self.given = given
        self.declared: set[str] = set()
        self.nodes: list[dict[str, Any]] = []
        self.included: list[Launch] = []
        self.messages: list[str] = []
        self.others: list[Any] = []
        self.context = launch_stub.Context() if context is None else context
        self.context.update(given)
        with launch_stub.installed():
            path = ROOT / "launch" / f"{name}.launch.py"
            description = runpy.run_path(str(path))["generate_launch_description"]()
        for part in description.arguments[0]:
            self._take(part)
        assert set(given) <= self.declared, "an argument that the file does not declare"

    def _take(self, part: Any) -> None:
        kind = type(part).__name__
        if kind == "DeclareLaunchArgument":
            name = part.arguments[0]
            assert part.description
            self.declared.add(name)
            if name not in self.context:
                self.context[name] = self._resolve(part.default_value)
        elif kind == "OpaqueFunction":
            for each in part.function(self.context):
                self._take(each)
        elif kind == "IncludeLaunchDescription":
            path = Path(part.arguments[0].arguments[0])
            assert path.exists()
            given = {key: self._resolve(value) for key, value in part.launch_arguments}
            name = path.name.removesuffix(".launch.py")
            self.included.append(Launch(name, self.context, **given))
        elif kind == "LogInfo":
            self.messages.append(part.msg)
        elif kind == "Node":
            self.nodes.append(self._node(part))
        else:
            self.others.append(part)

    def _resolve(self, value: Any) -> Any:
        return launch_stub.resolve(value, self.context)

    def _node(self, part: Any) -> dict[str, Any]:
        values: dict[str, Any] = {}
        files = []
        for each in map(self._resolve, part.parameters):
            if isinstance(each, dict):
                values |= {key: self._resolve(value) for key, value in each.items()}
            else:
                files.append(each)
        return {
            "executable": (part.package, part.executable),
            "namespace": self._resolve(part.namespace),
            "values": values,
            "files": files,
        }


def check_agent(node: dict[str, Any]) -> dict[str, Any]:
    """Check that the agent accepts the parameters; return all of them, defaults included."""
    assert node["executable"] == (PACKAGE, "agent")
    values = {p.name: p.initial for p in parameters.PARAMETERS}
    for file in node["files"]:
        values |= yaml.safe_load(Path(file).read_text())["/**"]["ros__parameters"]
    values |= node["values"]
    parameters.settings_from(values)
    return values


def ros_parameters(node: dict[str, Any], folder: Path, domain: int) -> dict[str, Any]:
    """Return the parameters that ROS gives to a node of a launch file."""
    overrides = folder / "overrides.yaml"  # as launch_ros writes it
    overrides.write_text(yaml.safe_dump({"/**": {"ros__parameters": node["values"]}}))
    file, *others = node["files"]
    words = [word for each in (file, overrides, *others) for word in ("--params-file", str(each))]
    context = Context()
    rclpy.init(
        args=["--ros-args", "-r", f"__ns:=/{node['namespace']}", *words],
        context=context,
        domain_id=domain,
    )
    try:
        found = rclpy.create_node(
            "agent", context=context, automatically_declare_parameters_from_overrides=True
        )
        return {name: each.value for name, each in found.get_parameters_by_prefix("").items()}
    finally:
        rclpy.try_shutdown(context=context)


@pytest.fixture
def robot_state_publisher(share: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that robot_state_publisher is installed."""
    import ament_index_python.packages as packages

    monkeypatch.setattr(packages, "get_package_prefix", lambda _name: "/opt/ros/jazzy")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def params_file(folder: Path, **values: Any) -> str:
    """Write a parameter file that holds for any node; return its path."""
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
    return str(path)


@pytest.mark.usefixtures("share")
class TestLaunch:
    @pytest.mark.parametrize("name", ["agent", "bringup"])
    def test_launch_arguments_override_the_parameter_file(self, name: str, tmp_path: Path):
        mine = {"ip": "172.20.8.74", "port": 5999, "frame_prefix": "r9/"}
        file = params_file(tmp_path, **mine)
        (node,) = Launch(name, params_file=file).nodes
        assert mine.items() <= check_agent(node).items()
        given = {"ip": "172.20.8.75", "port": "0", "frame_prefix": "r1/", "namespace": "robot7"}
        (node,) = Launch(name, params_file=file, **given).nodes
        values = check_agent(node)
        assert (values["ip"], values["port"]) == ("172.20.8.75", 0)
        assert (values["frame_prefix"], node["namespace"]) == ("r1/", "robot7")

    @pytest.mark.parametrize(
        "text",
        [
            "{/**: {ros__parameters: {ip: IP}}}",
            "{/**: {ros__parameters: {nav2: true}}, /r1/agent: {ros__parameters: {ip: IP}}}",
            "{/r1: {agent: {ros__parameters: {ip: IP}}}, /**: {ros__parameters: {nav2: true}}}",
            "{/**: {ros__parameters: {ip: 1.1.1.1}}, /*/agent: {ros__parameters: {ip: IP}},"
            " r1: {agent: {ros__parameters: {ip: 2.2.2.2}}}}",
        ],
    )
    def test_a_simulation_is_not_connected_to_the_robot_of_a_section(
        self, text: str, tmp_path: Path, domain: int
    ):
        """ROS reads the arguments in the section of all nodes, and later sections win."""
        file = tmp_path / "mine.yaml"
        file.write_text(text.replace("IP", "172.20.8.74"))
        launch = Launch("sim", port="0", namespace="r1", params_file=str(file))
        found = ros_parameters(launch.included[0].nodes[0], tmp_path, domain)
        assert found["ip"] == "127.0.0.1"
        assert found.get("nav2") is (True if "nav2" in text else None)

    def test_a_simulation_does_not_start_the_robots_of_a_file(self, tmp_path: Path):
        file = params_file(tmp_path, robots=["r1", "r2"])
        with pytest.raises(ValueError, match=r"sets robots to \['r1', 'r2'\].*only one; remove"):
            Launch("sim", port="0", params_file=file)

    @pytest.mark.parametrize("name", ["agent", "bringup", "sim"])
    def test_a_wrong_port_and_a_parameter_file_that_does_not_exist_are_refused(self, name: str):
        """`ros2 launch` would start the agent without the file, with the default address."""
        port = {"port": "0"} if name == "sim" else {}
        with pytest.raises(ValueError, match=r"params_file is not a file: nowhere\.yaml"):
            Launch(name, params_file="nowhere.yaml", **port)
        for wrong in ("548O", "65536", "-1", *([""] if name == "sim" else [])):
            expected = f"port must be a whole number from 0 to 65535, not '{wrong}'"
            with pytest.raises(ValueError, match=expected):
                Launch(name, port=wrong)

    @pytest.mark.parametrize(("text", "value"), [("true", True), ("False", False)])
    def test_nav2_is_true_or_false(self, text: str, value: bool):
        (node,) = Launch("bringup", nav2=text).nodes
        assert check_agent(node)["nav2"] is value
        with pytest.raises(ValueError, match="nav2 must be true or false, not 'yes'"):
            Launch("agent", nav2="yes")

    def test_bringup_works_without_robot_state_publisher(self):
        launch = Launch("bringup", ip="172.20.8.74", frame_prefix="r1/", urdf="mine.urdf")
        (node,) = launch.nodes
        (message,) = launch.messages
        assert message == (
            "robot_state_publisher is not installed, so the model is not published: mine.urdf"
        )
        values = check_agent(node)
        assert values["publish_tf"] is True
        assert values["publish_laser_tf"] is True
        assert values["frame_prefix"] == "r1/"

    @pytest.mark.usefixtures("robot_state_publisher")
    def test_bringup_starts_robot_state_publisher_if_installed(self):
        agent, model = Launch("bringup", ip="172.20.8.74", frame_prefix="r1/").nodes
        assert check_agent(agent)["publish_laser_tf"] is False
        assert model["executable"] == ("robot_state_publisher",) * 2
        assert model["values"]["frame_prefix"] == "r1/"
        assert "<robot" in model["values"]["robot_description"]

    @pytest.mark.usefixtures("robot_state_publisher")
    @pytest.mark.parametrize(
        ("text", "prefix"),
        [
            ("/**: {ros__parameters: {frame_prefix: r9/}}", "r9/"),
            ("/r9/agent: {ros__parameters: {frame_prefix: r9/}}", "r9/"),
            ("/r9: {agent: {ros__parameters: {frame_prefix: r9/}}}", "r9/"),
            (
                "{/r9/agent: {ros__parameters: {frame_prefix: r9/}},"
                " /**: {ros__parameters: {frame_prefix: all/}}}",
                "all/",
            ),
            (
                "{/**: {ros__parameters: {frame_prefix: all/}},"
                " /r9/agent: {ros__parameters: {frame_prefix: r9/}}}",
                "r9/",
            ),
            ("/*/agent: {ros__parameters: {frame_prefix: r9/}}", "r9/"),
            ("/*/*/agent: {ros__parameters: {frame_prefix: r9/}}", ""),
            ("agent: {ros__parameters: {frame_prefix: r9/}}", ""),
            ("", ""),
        ],
    )
    def test_the_model_has_the_agents_prefix(self, text: str, prefix: str, tmp_path: Path):
        """Without the prefix, the robot's frames would not form a single tree."""
        file = tmp_path / "mine.yaml"
        file.write_text(text)
        _, model = Launch("bringup", namespace="r9", params_file=str(file)).nodes
        assert model["values"]["frame_prefix"] == prefix

    def test_sim_starts_agent_and_simulator(self):
        port = str(free_port())
        launch = Launch("sim", port=port, speed="2")
        (simulator,) = launch.others
        path, *arguments = simulator.cmd
        assert Path(path).name in EXECUTABLES
        assert arguments == (
            ["--host", "127.0.0.1", "--port", port, "--tcp-port", "0", "--speed", "2"]
        )
        (bringup,) = launch.included
        values = check_agent(bringup.nodes[0])
        assert (values["ip"], values["port"]) == ("127.0.0.1", int(port))

    def test_sim_finds_a_free_port_and_does_not_start_at_one_in_use(self):
        """Port 0 means the standard port to the agent, where another chassis may be."""
        launch = Launch("sim", port="0")
        (simulator,) = launch.others
        (bringup,) = launch.included
        port = check_agent(bringup.nodes[0])["port"]
        assert port > 0
        assert simulator.cmd[simulator.cmd.index("--port") + 1] == str(port)
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            with pytest.raises(ValueError, match=rf"cannot use port {port}.*in use.*port:="):
                Launch("sim", port=str(port))

    def test_the_end_of_the_simulator_ends_sim(self):
        """The agent would reconnect to whatever listens at the port next."""
        launch = Launch("sim", port="0")
        (simulator,) = launch.others
        ended = SimpleNamespace(returncode=1)
        # an exception ends the launch, with status 1
        with pytest.raises(RuntimeError, match="the simulated chassis has ended, with status 1"):
            simulator.on_exit(ended, launch.context)
        launch.context.is_shutdown = True
        assert simulator.on_exit(ended, launch.context) is None

    @pytest.mark.parametrize(
        ("name", "argument", "as_path"),
        [
            ("agent", "urdf:=mine.urdf", False),
            ("bringup", "adress:=172.20.8.74", True),
            ("sim", "ip:=172.20.8.74", False),
            ("fleet", "robot:=my_robots.yaml", True),
        ],
    )
    def test_unknown_arguments_of_the_command_line_are_refused(
        self, monkeypatch: pytest.MonkeyPatch, name: str, argument: str, as_path: bool
    ):
        """`ros2 launch` ignores them."""
        file = f"{name}.launch.py"
        words = [f"launch/{file}"] if as_path else ["woosh_robot_agent", file]
        monkeypatch.chdir(ROOT)
        monkeypatch.setattr("sys.argv", ["/opt/ros/jazzy/bin/ros2", "launch", *words, argument])
        context = launch_stub.Context()
        context.argv = [argument]
        unknown = argument.partition(":=")[0]
        with pytest.raises(ValueError, match=rf"{file} has no argument {unknown}; it has \w+"):
            Launch(name, context)

    @pytest.mark.parametrize(
        "words",
        [
            ["mine", "sim.launch.py"],
            ["sim.launch.py"],  # in a folder of the user
            ["woosh_robot_agent", "sim.launch.py", "--launch-prefix", "gdb"],
        ],
    )
    def test_other_arguments_are_accepted(self, monkeypatch, words, tmp_path):
        """Launch files that include these have arguments of their own, and `launch` has some."""
        (tmp_path / "sim.launch.py").touch()
        monkeypatch.chdir(tmp_path)
        context = launch_stub.Context()
        context.argv = ["launch-prefix:=gdb"] if "gdb" in words else ["world:=hall", "port:=0"]
        monkeypatch.setattr("sys.argv", ["ros2", "launch", *words, *context.argv])
        assert Launch("sim", context, port="0").others

    def test_fleet_starts_all_robots(self):
        agents = [check_agent(each.nodes[0]) for each in Launch("fleet").included]
        assert [(v["port"], v["frame_prefix"]) for v in agents] == [(5480, "r1/"), (5490, "r2/")]

    @pytest.mark.usefixtures("robot_state_publisher")
    def test_robots_of_a_fleet_share_no_parameters(self, tmp_path: Path):
        file = tmp_path / "fleet.yaml"
        urdf = tmp_path / "mine.urdf"
        urdf.write_text("<robot name='mine'/>")
        first = {
            "ip": "172.20.8.74",
            "port": 5999,
            "params_file": params_file(tmp_path, robot_id=7),
            "urdf": str(urdf),
            "namespace": "hall/r1",
            "frame_prefix": "one/",
        }
        file.write_text(
            yaml.safe_dump({"robots": [{"name": "r1", **first}, {"name": "/r2", "ip": "b"}]})
        )
        ones, others = (each.nodes for each in Launch("fleet", robots=str(file)).included)
        found = check_agent(ones[0])
        assert (found["port"], found["robot_id"], found["frame_prefix"]) == (5999, 7, "one/")
        assert ones[1]["values"]["robot_description"] == urdf.read_text()
        found = check_agent(others[0])
        assert (found["ip"], found["port"], found["robot_id"]) == ("b", 0, 0)
        assert (others[0]["namespace"], found["frame_prefix"]) == ("/r2", "r2/")
        assert "woosh_base" in others[1]["values"]["robot_description"]

    @pytest.mark.parametrize("name", ["fleet", "sim"])
    def test_included_files_get_all_their_arguments(self, name: str):
        """ROS would take a missing argument from another launch file."""
        for each in Launch(name, **({"port": "0"} if name == "sim" else {})).included:
            assert set(each.given) == each.declared

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "robots: {}",
            "robots: [{name: r1}]",
            "robots: [{name: r1, ip: a, colour: red}]",
            "robots: [{name: r1, ip: a}, {name: /r1, ip: b}]",
        ],
    )
    def test_invalid_fleet_file_is_refused(self, text: str, tmp_path: Path):
        file = tmp_path / "fleet.yaml"
        file.write_text(text)
        with pytest.raises(ValueError, match=r"fleet\.yaml"):
            Launch("fleet", robots=str(file))


class TestConfiguration:
    def test_the_model_is_valid(self):
        robot = ElementTree.parse(ROOT / "config/woosh_base.urdf").getroot()
        links = {link.get("name") for link in robot.iter("link")}
        assert {"base_link", "laser"} <= links
        for joint in robot.iter("joint"):
            assert {joint.find("parent").get("link"), joint.find("child").get("link")} <= links  # type: ignore[union-attr]

    @pytest.mark.parametrize("file", ["woosh.rviz", "foxglove_layout.json"])
    def test_displays_show_existing_topics(self, file: str):
        text = (ROOT / "config" / file).read_text()
        shown = set(re.findall(r"/woosh_robot/([\w/]+)", text))
        assert len(shown) >= 4
        # robot_state_publisher publishes robot_description
        assert shown <= {each.name for each in (*STANDARD, *TOPICS)} | {"robot_description"}
