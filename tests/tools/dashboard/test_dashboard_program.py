"""The program `dashboard` in a process of its own, and its end while a stick drives the robot."""

from __future__ import annotations

import asyncio
import signal
import ssl
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import InvalidHandshake

from tests.asynchronous import eventually
from tests.tools.dashboard.conftest import new_certificate
from tests.tools.dashboard.pages import fetch, page, place, program
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard import program as dashboard_program
from woosh_robot_agent.tools.dashboard.program import _run, _tls, main, make_parser
from woosh_robot_agent.tools.dashboard.server import DashboardConfig


async def end_while_driving(chassis: SimulatorThread, end: signal.Signals) -> int:
    """End a new program while its stick drives the robot; return its exit status."""
    with program(chassis) as (process, url):
        async with page(url) as viewer:
            await viewer.ready()
            async with viewer.holds(0.3):
                await eventually(lambda: chassis.state.velocity.forward > 0.1)
                process.send_signal(end)
                await eventually(lambda: process.poll() is not None)
        await eventually(lambda: chassis.state.velocity.forward == 0.0)
        return int(process.returncode)


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGHUP])
async def test_the_end_of_the_program_stops_the_robot(
    end: signal.Signals, chassis: SimulatorThread
) -> None:
    assert await end_while_driving(chassis, end) == 0
    assert chassis.last(full_name(Twist)) == Twist()  # otherwise the chassis has stopped by itself


async def test_the_chassis_stops_by_itself_when_the_program_is_killed(
    chassis: SimulatorThread,
) -> None:
    while True:
        assert await end_while_driving(chassis, signal.SIGKILL) == -signal.SIGKILL
        if chassis.last(full_name(Twist)) != Twist():  # no zero has come
            break
        # on a busy machine, the connection was too slow, and the stick had stopped the robot


async def test_the_page_is_served_over_https_and_a_robot_that_is_named_twice_is_shown_once(
    chassis: SimulatorThread, certificate: list[str]
) -> None:
    tls = ssl.create_default_context(cafile=certificate[1])
    options = [*certificate, "--host", "0.0.0.0"]
    with program(chassis, chassis, options=options) as (process, url):
        assert url.startswith("https://")
        assert any(line.startswith("to watch only: https://") for line in process.stderr)
        local = url.replace(urlsplit(url).hostname or "", "127.0.0.1")
        path = f"/?{urlsplit(url).query}"
        status, headers, _ = await fetch(local, path, tls=tls)
        assert status == 200
        assert "; Secure" in headers["set-cookie"]
        cookie = headers["set-cookie"].partition(";")[0]
        async with page(local, tls=tls, Cookie=cookie) as viewer:
            assert len(await viewer.until(lambda parts: parts["hello"]["robots"])) == 1
            await viewer.give("speak", text="hello")
        plain = f"http://{place(local)}"
        with pytest.raises(InvalidHandshake):
            async with page(local, tls=tls, Cookie=cookie, Origin=plain):
                pass
        process.send_signal(signal.SIGINT)
        await eventually(lambda: process.poll() == 0)


async def test_a_renewed_certificate_is_used_without_a_restart(
    certificate: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(dashboard_program, "_RENEWAL_PERIOD", 0.05)
    (tmp_path / "new").mkdir()
    files, new_files = (
        [Path(each) for each in options[1::2]]
        for options in (certificate, new_certificate(tmp_path / "new"))
    )
    former, renewed = files[0].read_text(), new_files[0].read_text()
    options = make_parser().parse_args(["--ip", "127.0.0.1", *certificate])
    config = DashboardConfig(port=0, tls=_tls(make_parser(), options))
    robots = [LinkConfig(ip="127.0.0.1", port=1)]
    running = asyncio.create_task(_run(robots, config, certificate[1::2]))
    try:
        line = await eventually(lambda: capsys.readouterr().out)

        async def served() -> str:
            port = urlsplit(line.split()[-1]).port
            return await asyncio.to_thread(ssl.get_server_certificate, ("127.0.0.1", port))

        assert await served() == former
        files[0].write_text(renewed)  # its key is still that of the former one
        await eventually(lambda: "is still served with the former certificate" in caplog.text)
        assert await served() == former
        files[1].write_bytes(new_files[1].read_bytes())
        await eventually(lambda: "the renewed certificate is used" in capsys.readouterr().err)
        assert await served() == renewed
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--host", ""], "--host is empty"),
        (["--page-port", "70000"], "--page-port must be within"),
        (["--max-linear", "inf"], "--max-linear must be above 0"),
        (["--max-angular", "0"], "--max-angular must be above 0"),
        (["--tls-key", "key.pem"], "--tls-key needs --tls-cert"),
        (["--tls-cert", "nothing.pem"], "cannot use --tls-cert and --tls-key: [Errno 2] No such"),
    ],
)
def test_invalid_options_are_refused(
    options: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["--ip", "127.0.0.1", *options])
    assert problem in capsys.readouterr().err


def test_a_host_that_is_not_of_this_machine_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--ip", "127.0.0.1", "--host", "192.0.2.1", "--page-port", "0"]) == 1
    assert "choose an address of this machine with --host" in capsys.readouterr().err
