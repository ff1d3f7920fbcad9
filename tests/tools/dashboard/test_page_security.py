"""Who may open the page, and what may come in."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import InvalidHandshake
from websockets.frames import Frame, Opcode

from tests.asynchronous import TIMEOUT, eventually
from tests.tools.dashboard.pages import dashboard, fetch, page, place
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard import server
from woosh_robot_agent.tools.dashboard.access import Role
from woosh_robot_agent.tools.dashboard.server import Dashboard

_CONNECTION_LOST, _POLICY_VIOLATION, _TOO_BIG, _TRY_AGAIN_LATER = 1006, 1008, 1009, 1013

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The page loads nothing from other hosts and sends nothing to them; browsers report attempts."""


async def refused_socket(running: Dashboard, **headers: str) -> int:
    """Try to open a WebSocket; return the status of the refusal."""
    with pytest.raises(InvalidHandshake) as caught:
        async with page(running, **headers):
            pass
    error: Any = caught.value
    # before websockets 13, the error itself has the status
    return int(getattr(error, "response", error).status_code)


async def test_every_response_has_the_security_headers(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running:
        _, _, content = await fetch(running, "/")
        for status, path, method, headers in (
            (200, "/", "GET", {}),
            (200, "/", "HEAD", {}),
            (200, "/main.js", "GET", {}),
            (404, "/nothing", "GET", {"Accept-Language": "zh-CN,zh;q=0.9,en;q=0.8"}),
            (403, "/", "GET", {"Host": "example.com"}),
            (405, "/", "POST", {}),
            (405, "/", "PROPFIND", {}),
        ):
            answer, found, body = await fetch(running, path, headers, method)
            assert answer == status, (path, method)
            assert found["content-security-policy"] == _POLICY
            assert found["x-content-type-options"] == "nosniff"
            assert found["cross-origin-resource-policy"] == "same-origin"
            assert found["cache-control"] == "no-store"
            if method == "HEAD":
                assert (int(found["content-length"]), body) == (len(content), b"")
            elif status == 404:  # in the language of the browser
                assert body.decode().strip() == "没有这个页面"
                assert "charset=utf-8" in found["content-type"]
            elif status == 405:
                assert found["allow"] == "GET, HEAD"


async def test_there_is_nothing_else_to_read(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running:
        for path in (
            "/../program.py",
            "/%2e%2e/program.py",
            "//etc/passwd",
            "/page/main.js",
            "/map/0/1.png/../../x",
            "/map/9/1.png",
            "/map/-1/1.png",
            f"/map/{'9' * 5000}/1.png",
            "/map/",
            "/[",
            "//[",
        ):
            status, _, _ = await fetch(running, path)
            assert status == 404, path


async def test_another_name_for_this_machine_is_refused(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running:
        port = place(running).rpartition(":")[2]
        others = ("evil.example", f"evil.example:{port}", "10.0.0.1", "[", "127.0.0.1/x", "")
        for host in (*others, "evil.example@127.0.0.1", f"evil@localhost:{port}"):
            status, _, body = await fetch(running, "/", {"Host": host})
            assert status == 403, host
        assert b"no valid Host header" in body
        for host in ("localhost", f"localhost:{port}", f"127.0.0.1:{port}", f"[::1]:{port}"):
            status, _, _ = await fetch(running, "/", {"Host": host})
            assert status == 200, host


async def test_pages_of_other_sites_cannot_connect(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running:
        for origin in ("http://evil.example", "null", "", "http://127.0.0.1:1"):
            assert await refused_socket(running, Origin=origin) == 403, origin


async def test_other_machines_need_the_token(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as local_only:
        assert "token" not in local_only.url
    async with dashboard(chassis, host="0.0.0.0") as running:
        token = running.url.partition("?token=")[2]
        assert len(token) >= 20
        local = f"127.0.0.1:{place(running).rpartition(':')[2]}"
        for path in ("/", "/main.js", "/map/0/1.png", "/?token=wrong", "/?token=%C3%A4"):
            assert (await fetch(running, path))[0] == 403, path
        assert await refused_socket(running) == 403
        status, headers, _ = await fetch(running, f"/?token={token}", {"Host": local})
        assert status == 200
        cookie = headers["set-cookie"]
        assert {"Path=/", "HttpOnly", "SameSite=Strict"} == set(cookie.split("; ")[1:])
        sent = {"Cookie": cookie.partition(";")[0]}
        assert (await fetch(running, "/main.js", sent))[0] == 200
        assert await refused_socket(running, **sent, Origin="http://evil.example") == 403
        async with page(running, **sent) as viewer:
            await viewer.until(lambda parts: parts["hello"])


async def test_a_token_of_the_user_may_have_any_characters(chassis: SimulatorThread) -> None:
    tokens = dict.fromkeys(Role, "of base64: a+b/c==; and ä")
    async with dashboard(chassis, host="0.0.0.0", tokens=tokens) as running:
        found = urlsplit(running.url)
        local = {"Host": f"127.0.0.1:{found.port}"}
        status, headers, _ = await fetch(running, f"/?{found.query}", local)
        assert status == 200
        sent = {**local, "Cookie": headers["set-cookie"].partition(";")[0]}
        assert (await fetch(running, "/main.js", sent))[0] == 200


_NEVER_SENT = (
    "hello",
    "[]",
    "null",
    "[" * 4000,
    '{"do": "watch"}',
    '{"do": "watch", "robot": 1}',
    '{"do": "watch", "robot": -1}',
    '{"do": "watch", "robot": "0"}',
    '{"do": "visible", "visible": 1}',
    '{"do": "format the disk"}',
    '{"do": "command", "id": 1, "name": "stop", "args": {}, "clock": 1e400}',
    '{"do": "command", "id": 1, "name": "stop", "args": {}, "clock": 1%s}' % ("0" * 400),
    b"{}",
    b"\xff\xfe",
)
"""Messages that no page sends."""


async def test_a_message_that_the_page_never_sends_ends_the_connection(
    chassis: SimulatorThread,
) -> None:
    async with dashboard(chassis) as running:
        for message in _NEVER_SENT:
            async with page(running) as viewer:
                await viewer.socket.send(message)
                assert await viewer.closed() == _POLICY_VIOLATION, message
        async with page(running) as viewer:
            await viewer.send(do="watch", robot=0, more="x" * 5000)
            assert await viewer.closed() == _TOO_BIG


@pytest.mark.parametrize(
    "frame",
    [
        Frame(Opcode.TEXT, b'{"do": "visible", "visible": true}'),
        Frame(Opcode.PING, b""),
        Frame(Opcode.TEXT, b"", fin=False),
    ],
    ids=["messages", "pings", "fragments"],
)
async def test_a_flood_ends_the_connection(chassis: SimulatorThread, frame: Any) -> None:
    async with dashboard(chassis) as running, page(running) as viewer:
        await viewer.until(lambda parts: parts["hello"])
        first = frame.serialize(mask=True)
        if not frame.fin:
            frame = Frame(Opcode.CONT, b"", fin=False)
        viewer.socket.transport.write(first + 20_000 * frame.serialize(mask=True))
        assert await viewer.closed() == _CONNECTION_LOST
        async with page(running) as other:  # nobody else is disturbed
            await other.until(lambda parts: parts["hello"])


async def test_a_viewer_for_which_too_much_waits_is_disconnected(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running, page(running) as viewer:
        await viewer.until(lambda parts: parts["hello"])
        # all are there at once, so that no answer is sent before the last one has been made
        command = b'{"do": "command", "id": 1, "name": "", "args": {}, "clock": 0}'
        frame = Frame(Opcode.TEXT, command).serialize(mask=True)
        viewer.socket.transport.write(110 * frame)
        assert await viewer.closed() == _CONNECTION_LOST


async def test_a_new_viewer_takes_the_place_of_one_that_does_not_drive(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_MAX_VIEWERS", 2)
    async with dashboard(chassis, control=True) as running:
        async with page(running) as driver, page(running) as first, page(running) as hidden:
            for each in driver, first, hidden:
                await each.until(lambda parts: parts["robot"]["known"])
            await driver.give("goMark", mark="A2")
            await hidden.send(do="visible", visible=False)
            await first.send(do="visible", visible=True)
            await first.command("speak", text="")  # refused, but heard
            async with page(running) as fourth, page(running) as fifth:
                assert await hidden.closed() == _TRY_AGAIN_LATER
                assert await first.closed() == _TRY_AGAIN_LATER
                await fourth.until(lambda parts: parts["control"]["owner"])
                await fifth.give("stop")
            await driver.until(lambda parts: not parts["robot"]["task"]["running"])
        await eventually(lambda: not running.robots[0].parts.watched.is_set())


async def test_no_place_is_left_if_all_viewers_have_control(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_MAX_VIEWERS", 0)
    async with dashboard(chassis, control=True) as running, page(running) as driver:
        await driver.until(lambda parts: parts["robot"]["known"])
        await driver.give("goMark", mark="A2")
        async with page(running) as other:
            assert await other.closed() == _TRY_AGAIN_LATER


async def test_connections_that_ask_for_nothing_do_not_keep_viewers_out(
    chassis: SimulatorThread,
) -> None:
    async with dashboard(chassis) as running:
        host, _, port = place(running).rpartition(":")
        idle = [await asyncio.open_connection(host, port) for _ in range(100)]
        with contextlib.suppress(ConnectionResetError):
            assert await asyncio.wait_for(idle[0][0].read(), TIMEOUT) == b""
        async with page(running) as viewer:
            await viewer.until(lambda parts: parts["hello"])
        for _, writer in idle:
            writer.transport.abort()
