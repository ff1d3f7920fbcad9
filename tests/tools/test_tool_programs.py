"""The tools as programs: options, exit status and output."""

from __future__ import annotations

import argparse
import json
import logging
import os
import re
import resource
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.quick_chassis import edit_bodies
from tests.simulator.sim_wire import JsonClient
from tests.tools.programs import HOSTILE, TIMEOUT, address, end, harmless, run, start
from tests.tools.recordings import add_numbered, writer
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneDataEasy, SceneList
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_agent.tools import __main__ as tools
from woosh_robot_agent.tools.doctor import program as doctor
from woosh_robot_agent.tools.maps import program as maps
from woosh_robot_agent.tools.monitor import program as monitor
from woosh_robot_agent.tools.options import add_link_options, link_arguments, link_config
from woosh_robot_agent.tools.recording import record, replay
from woosh_robot_agent.tools.recording.layout import Event
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_agent.tools.recording.timeline import prepare
from woosh_robot_agent.vda5050 import __main__ as vda5050

ROOT = Path(__file__).parents[2]
LISTEN = ["--listen", "127.0.0.1:0"]
TOOLS = ("dashboard", "monitor", "doctor", "record", "replay", "maps")


RunHere = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run_here(capsys: pytest.CaptureFixture[str]) -> RunHere:
    """Function that runs a program in this process; as `run`."""

    def run_program(main: Callable[[Sequence[str]], int], *arguments: str) -> tuple[int, str, str]:
        status = main(arguments)
        return (status, *capsys.readouterr())

    return run_program


def empty_recording(folder: Path) -> Path:
    """Write a recording of one connection without frames."""
    path = folder / "a.mcap"
    file = writer(path)
    file.add_event(1, "open", "client")
    file.close()
    return path


def test_every_tool_has_an_entry_point_and_a_help_text_without_ros() -> None:
    code = "import sys\nfrom woosh_robot_agent.tools.__main__ import start\n"
    code += f"for tool in {TOOLS}:\n    try: start(tool, ['--help'])\n    except SystemExit: pass\n"
    code += "print([name for name in sys.modules if name.startswith(('rclpy', 'rosidl'))])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("\n[]\n")
    assert done.stderr == ""
    for tool in TOOLS:
        entry_point = f'"{tool} = woosh_robot_agent.tools.__main__:{tool}"'
        assert entry_point in (ROOT / "setup.py").read_text()
        assert f"usage: {tool} " in done.stdout


def test_a_tool_that_does_not_exist_is_named() -> None:
    command = [sys.executable, "-m", tools.__package__, "bogus"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("usage: ")
    assert done.stderr.endswith("error: there is no tool 'bogus'\n")


def test_ctrl_c_while_a_tool_starts_ends_it_without_a_traceback() -> None:
    code = """
import signal, sys
class CtrlC:
    def find_spec(self, name, *args):
        if name == "google.protobuf":
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, CtrlC())
from woosh_robot_agent.tools.__main__ import monitor
sys.exit(monitor(["--help"]))
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize(
    "command",
    [
        "tools monitor --ip 127.0.0.1:{port}",
        "simulator --port 0 --tcp-port 0",
    ],
)
def test_a_reader_that_has_gone_ends_a_program_quietly(chassis, command):
    module, *arguments = command.format(port=chassis.port).split()
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", f"woosh_robot_agent.{module}", *arguments],
        stdout=writer,
        stderr=subprocess.PIPE,
        timeout=2 * TIMEOUT,
        check=False,
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, b"")


def test_texts_of_the_robot_cannot_control_the_terminal_of_doctor(chassis, capsys):
    def edit(info: RobotInfo) -> None:
        info.genral.display_model = HOSTILE
        info.abnormal_codes.scs.add(code=1, msg=HOSTILE)

    edit_bodies(chassis, RobotInfo, edit)
    doctor.main(address(chassis))
    out, err = capsys.readouterr()
    assert harmless(out + err)
    assert len([line for line in out.splitlines() if "taskable" in line[:14]]) == 1
    doctor.main([*address(chassis), "--json"])
    out, err = capsys.readouterr()
    assert harmless(out + err)
    assert HOSTILE in json.loads(out)["checks"][3]["text"]

    chassis.intercept(lambda frame: [replace(frame, ok=False, msg=HOSTILE)])
    assert doctor.main(address(chassis)) == 1
    out, err = capsys.readouterr()
    assert harmless(out + err)


def test_texts_of_the_robot_cannot_control_the_terminal_of_maps(chassis, capsys):
    def run_maps(*arguments: str) -> tuple[int, str]:
        status = maps.main([*address(chassis), *arguments])
        out, err = capsys.readouterr()
        assert harmless(out + err)
        return status, out + err

    def name_all(frame: Outgoing) -> list[Outgoing]:
        if isinstance(frame.body, SceneList):
            del frame.body.scenes[1:]
            frame.body.scenes[0].name = HOSTILE
        if frame.request == full_name(SceneDataEasy):
            body = SceneDataEasy(maps=[SceneDataEasy.Map(name=HOSTILE, floor=HOSTILE)])
            return [replace(frame, type=frame.request, ok=True, body=body)]
        return [frame]

    chassis.intercept(name_all)
    status, text = run_maps("list")
    assert (status, len(text.splitlines())) == (0, 2)
    assert "owned" in text
    status, text = run_maps("list", "--json")
    assert json.loads(text)[0]["scene"] == HOSTILE
    status, text = run_maps("download", "nothing")
    assert status == 1
    assert "owned" in text
    assert run_maps("rename", HOSTILE, "a b")[0] == 1
    chassis.intercept(lambda frame: [replace(frame, ok=frame.sn == 1, msg=HOSTILE)])
    assert run_maps("list")[0] == 1


def test_the_logs_of_all_programs_are_harmless() -> None:
    """They all log by `log_to_stderr`, whose formatter has tests of its own."""
    package = ROOT / "woosh_robot_agent"
    for folder in ("simulator", "tools", "vda5050"):
        for file in (package / folder).rglob("*.py"):
            assert not re.search(r"\b(basicConfig|StreamHandler)\b", file.read_text()), file


def test_record_works_without_an_agent(run_here, chassis, tmp_path):
    path = tmp_path / "a.mcap"
    arguments = [*address(chassis), "--output", str(path), "--duration", "0.5"]
    status, out, _ = run_here(record.main, *arguments)
    assert status == 0
    assert out.startswith(f"recording ws://127.0.0.1:{chassis.port} to {path}\n")
    assert re.search(r"recorded \d+ frames of 1 connection to", out)
    recording = read_recording(path)
    assert recording.damage == ""
    assert "woosh.robot.RobotInfo" in prepare(recording).answers.types


def parsed(*arguments: str) -> LinkConfig:
    parser = argparse.ArgumentParser(prog="tool")
    add_link_options(parser)
    return link_config(parser, parser.parse_args(arguments))


@pytest.mark.parametrize(
    ("arguments", "host", "port"),
    [
        (["--ip", "robot.local"], "robot.local", 5480),
        (["--ip", "robot.local", "--transport", "tcp"], "robot.local", 5481),
        (["--ip", "1.1.1.1:5490"], "1.1.1.1", 5490),
        (["--ip", "::1"], "::1", 5480),
        (["--ip", "[::1]"], "::1", 5480),
        (["--ip", "[::1]:5490", "--encoding", "protobuf", "--robot-id", "7"], "::1", 5490),
    ],
)
def test_the_address_of_the_robot_may_have_a_port(arguments, host, port):
    config = parsed(*arguments)
    assert (config.ip, config.effective_port) == (host, port)
    # the options in a hint are those that were given
    assert parsed(*shlex.split(link_arguments(config))) == config


_WRONG_ADDRESSES = (
    *("1.1.1.1:99999", "1.1.1.1:", "1.1.1.1:http", ":5480", "ws://1.1.1.1:5480", "[::1", "::1]"),
    "",
)


@pytest.mark.parametrize(
    ("tool", "addresses"),
    [
        ("doctor", _WRONG_ADDRESSES),
        *((tool, ("[::1",)) for tool in ("dashboard", "monitor", "record", "maps", "vda5050")),
    ],
)
def test_every_tool_refuses_a_wrong_address_in_the_same_words(tool, addresses, capsys):
    main = vda5050.main if tool == "vda5050" else getattr(tools, tool)
    more = {"maps": ["list"], "vda5050": ["--broker", "mqtt://127.0.0.1"]}.get(tool, [])
    for wrong in addresses:
        with pytest.raises(SystemExit) as ending:
            main(["--ip", wrong, *more])
        assert ending.value.code == 2
        expected = "argument --ip: must be HOST or HOST:PORT, with a port within 1 to 65535: "
        assert f"{expected}{wrong!r}" in capsys.readouterr().err


def test_a_hint_has_the_given_port_and_transport(run_here: RunHere, tmp_path: Path) -> None:
    where, path = "--ip 127.0.0.1:1 --transport tcp", tmp_path / "a.mcap"
    for main, arguments in (
        (monitor.main, ["--once", "--timeout", "0.5"]),
        (maps.main, ["list"]),
        (record.main, ["--duration", "0.5", "--output", str(path)]),
    ):
        status, out, err = run_here(main, *where.split(), *arguments)
        assert status == 1
        assert f"doctor {where}" in " ".join((out + err).replace("│", " ").split())
    assert "error: no robot answered at tcp://127.0.0.1:1: Connection refused; check that" in err
    assert "recorded" not in out
    records = read_recording(path).records
    assert {record.kind for record in records if isinstance(record, Event)} <= {"refused"}


def test_record_of_a_program_that_is_no_robot_fails(run_here: RunHere, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        arguments = ["--ip", f"127.0.0.1:{port}", "--transport", "tcp", "--duration", "0.5"]
        status, _, err = run_here(record.main, *arguments, "--output", str(tmp_path / "a.mcap"))
    assert logging.getLogger("woosh_robot_agent.link").level == logging.NOTSET
    assert status == 1
    assert f"error: no robot answered at tcp://127.0.0.1:{port}: " in err


def test_record_does_not_overwrite_a_file(run_here: RunHere, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    status, _, err = run_here(record.main, "--ip", "127.0.0.1", "--output", str(path))
    assert status == 1
    assert f"error: cannot create {path}: File exists" in err
    assert path.read_text() == "mine"


FULL_DISK = """
import resource, sys
from woosh_robot_agent.tools.__main__ import record
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
sys.exit(record(sys.argv[1:]))
"""


def test_record_on_a_full_disk_names_the_file_and_leaves_none(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    arguments = ["--ip", "127.0.0.1", "--output", str(path)]
    done = subprocess.run(
        [sys.executable, "-B", "-c", FULL_DISK, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (1, f"error: cannot create {path}: File too large\n")
    assert not path.exists()  # it would block the next attempt


def test_record_that_cannot_start_leaves_no_file(run_here, chassis, tmp_path):
    arguments = [*address(chassis), "--output", str(tmp_path / "a.mcap")]
    port_in_use = f"127.0.0.1:{chassis.port}"
    for (status, _, err), reason in (
        (run("record", *arguments, "--ros", "not a namespace"), "error: --ros"),
        (run_here(record.main, *arguments, "--listen", port_in_use), "error: cannot listen on"),
    ):
        assert status == 1
        assert reason in err
        assert "\\n" not in err
        assert not list(tmp_path.iterdir())


def test_the_proxy_outlives_the_recording(
    chassis: SimulatorThread, tmp_path: Path, capsys: Any
) -> None:
    path = tmp_path / "a.mcap"
    there = [*LISTEN, "--output", str(path), "--max-size", "0.006"]
    with start("record", *address(chassis), *there) as process:
        port = re.search(r"agent to 127\.0\.0\.1:(\d+)", process.stdout.readline())
        assert port
        for _ in range(2):
            assert doctor.main(["--ip", f"127.0.0.1:{port[1]}"]) == 0, capsys.readouterr()
        status, _, err = end(process, signal.SIGTERM)
    assert status == 1
    assert "size limit" in err
    assert "the recording of frames has ended" in err
    assert "the proxy keeps running" in err
    assert re.search(r"error: frames that passed but are not recorded: \d+", err)
    assert path.stat().st_size < 0.1 * 2**20
    assert read_recording(path).damage == ""


def test_a_recording_that_cannot_be_completed_does_not_say_that_the_proxy_runs(
    chassis: SimulatorThread, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with start("record", *address(chassis), *LISTEN, "--output", str(path)) as process:
        assert "connect the agent to" in process.stdout.readline()
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (0, 0))  # as with a full disk
        status, _, err = end(process, signal.SIGTERM)
    assert status == 1
    assert f"error: the recording of frames has ended: cannot write to {path}: " in err
    assert "the proxy keeps running" not in err


def test_record_ends_at_its_limit_although_stderr_is_on_a_full_disk(
    chassis: SimulatorThread, tmp_path: Path
) -> None:
    arguments = ["--output", str(tmp_path / "a.mcap"), "--max-size", "0.04"]
    with (
        Path("/dev/full").open("w") as full,
        start("record", *address(chassis), *arguments, stderr=full) as process,
    ):
        status, _, _ = end(process, None)
    assert status in (1, 120)  # Python's own, if what it has buffered cannot be written


def test_a_program_whose_output_is_on_a_full_disk_says_so(chassis: SimulatorThread) -> None:
    with (
        Path("/dev/full").open("w") as full,
        start("monitor", *address(chassis), "--once", stdout=full) as process,
    ):
        status, _, err = end(process, None)
    assert (status, err) == (1, "error: cannot write the output: No space left on device\n")


def test_what_the_encoding_of_the_output_lacks_is_escaped(chassis: SimulatorThread) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    with start("monitor", *address(chassis), "--once", env=environment) as process:
        status, out, err = end(process, None)
    assert (status, err) == (0, "")
    assert "\\xb0" in out


def test_record_writes_the_address_of_its_proxy_with_brackets(capsys: Any) -> None:
    record._print_instructions(LinkConfig(), "::1", 5480, Path("a.mcap"))
    assert "connect the agent to [::1]:5480, e.g." in capsys.readouterr().out


def test_record_warns_if_other_machines_can_connect(run_here, chassis, tmp_path):
    arguments = ["--listen", "0.0.0.0:0", "--output", str(tmp_path / "a"), "--duration", "0.1"]
    status, _, err = run_here(record.main, *address(chassis), *arguments)
    assert status == 1
    assert "everybody who can reach 0.0.0.0 can command the robot" in err
    assert "nothing was recorded: no client connected" in err


def test_replay_says_what_is_missing_and_texts_of_clients_cannot_control_its_terminal(
    tmp_path: Path,
) -> None:
    file = writer(tmp_path / "a.mcap", split_size=5_000)
    add_numbered(file, 200)
    file.close()
    given = [file.files.paths[1], file.files.paths[3]]
    given[1].write_bytes(given[1].read_bytes()[:-20])
    with start("replay", *map(str, given), "--port", "0", "--tcp-port", "0") as process:
        ready = next(line for line in process.stdout if "replayed chassis ready" in line)
        port = re.search(r"ws://127\.0\.0\.1:(\d+)", ready)
        assert port
        client = JsonClient(int(port[1]))
        assert not client.request(HOSTILE, {})["ok"]
        client.close()
        status, _, err = end(process)
    assert status == 0
    assert f"end of the recording is missing: {given[1]} has no end" in err
    assert "files of this split recording are not given" in err
    assert "the numbers in their names: 0, 2\n" in err
    assert "owned" in err
    assert harmless(err)


def test_replay_at_a_port_in_use_fails(tmp_path: Path, capsys: Any) -> None:
    path = empty_recording(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert replay.main([str(path), "--port", "0", "--tcp-port", port]) == 1
    error = capsys.readouterr().err
    assert port in error
    assert "--tcp-port" in error


def test_replay_without_a_recording_fails(tmp_path, capsys):
    assert replay.main([str(tmp_path / "nothing.mcap")]) == 1
    missing = f"error: cannot read {tmp_path / 'nothing.mcap'}: No such file or directory\n"
    assert capsys.readouterr().err == missing


@pytest.mark.parametrize(
    ("tool", "arguments"),
    [
        ("doctor", ["--ip", "a b"]),
        ("doctor", ["--ip", "x", "--survey", "new", "--minutes", "601"]),
        ("monitor", ["--timeout", "nan"]),
        ("maps", ["list"]),
        ("maps", ["--ip", "127.0.0.1", "upload", "a", "b", "--scene", "c"]),
        ("maps", ["--ip", "127.0.0.1", "upload", "a", "--scene", ""]),
        ("maps", ["--ip", "127.0.0.1", "--timeout", "0", "list"]),
        ("maps", ["--ip", "127.0.0.1", "rename", "office", "a/b"]),
        ("maps", ["--ip", "127.0.0.1", "upload", "office", "--scene", ".."]),
        ("record", ["--ip", "x", "--listen", "x:70000"]),
        ("record", ["--ip", "x", "--max-size", "1e305"]),
        ("record", ["--ip", "x", "--max-size", "1 GiB"]),
        ("record", ["--ip", "x", "--duration", "inf"]),
        ("record", ["--ip", "x", "--split-size", "0.0000001"]),
        ("record", ["--ip", "x", "--split-duration", "-1"]),
        ("replay", ["f", "--speed", "0"]),
        ("replay", ["f", "--port", "70000"]),
    ],
)
def test_wrong_usage_ends_with_status_2(tool, arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ending:
        getattr(tools, tool)(arguments)
    assert ending.value.code == 2
    error = capsys.readouterr().err
    assert "error:" in error
    assert "invalid _" not in error  # argparse would show the name of a function
    assert not list(tmp_path.iterdir())
