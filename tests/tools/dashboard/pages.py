"""A dashboard in the event loop of a test, and a page without a browser that is connected to it."""

from __future__ import annotations

import asyncio
import http.client
import json
import math
import socket
import ssl
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, fields
from typing import Any
from urllib.parse import urlsplit

from tests.asynchronous import TIMEOUT
from tests.tools.programs import start
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.transport import Connect
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard import control
from woosh_robot_agent.tools.dashboard.control import ControlConfig
from woosh_robot_agent.tools.dashboard.server import Dashboard, DashboardConfig

try:
    from websockets.asyncio.client import ClientConnection as Socket

    _HEADERS_OPTION = "additional_headers"
except ImportError:  # before websockets 13
    from websockets.legacy.client import WebSocketClientProtocol as Socket

    _HEADERS_OPTION = "extra_headers"


TOO_SLOW = str(control.TOO_SLOW)
"""Reason of a refusal over a slow connection; on a busy machine it may come for a moment."""
MOMENTARY = (TOO_SLOW, "no data", str(control.UNANSWERED))
"""Reasons that end a press of the stick on a busy machine."""
SCAN_RATE = 2.0
"""Rate of the laser scans, in Hz; at the usual one, they take most of a test's processor time."""
_CONTROL = [field.name for field in fields(ControlConfig)]


@asynccontextmanager
async def dashboard(*robots: SimulatorThread, **options: Any) -> AsyncIterator[Dashboard]:
    # on a busy machine, everything may take long
    patience = {"request_timeout": TIMEOUT, "liveness_timeout": TIMEOUT}
    configs = [LinkConfig("127.0.0.1", robot.port, **patience) for robot in robots]
    timing = {name: options.pop(name) for name in _CONTROL if name in options}
    usual = {"port": 0, "scan_rate": SCAN_RATE, "control_config": ControlConfig(**timing)}
    config = DashboardConfig(**{**usual, **options})
    async with Dashboard(configs, config) as running:
        yield running


@contextmanager
def program(*robots: SimulatorThread, options: Sequence[str] = ()) -> Iterator[tuple[Any, str]]:
    """Start the program with control of some robots; yield its process and its address."""
    addresses = (f"--ip=127.0.0.1:{robot.port}" for robot in robots)
    with start("dashboard", "--control", "--page-port", "0", *options, *addresses) as process:
        yield process, process.stdout.readline().removeprefix("dashboard ready at ").strip()


def place(running: Dashboard | str) -> str:
    """Return host and port of a dashboard, or of the address of one."""
    return urlsplit(running if isinstance(running, str) else running.url).netloc


async def fetch(
    running: Dashboard | str,
    path: str,
    headers: dict[str, str] | None = None,
    method: str = "GET",
    tls: ssl.SSLContext | None = None,
) -> tuple[int, dict[str, str], bytes]:
    """Return status, headers and body of a page."""

    def get() -> tuple[int, dict[str, str], bytes]:
        connection: http.client.HTTPConnection
        if tls:
            connection = http.client.HTTPSConnection(place(running), context=tls, timeout=TIMEOUT)
        else:
            connection = http.client.HTTPConnection(place(running), timeout=TIMEOUT)
        connection.request(method, path, headers=headers or {})
        response = connection.getresponse()
        found = {name.lower(): value for name, value in response.getheaders()}
        return response.status, found, response.read()

    return await asyncio.to_thread(get)


def last(chassis: SimulatorThread, cls: Any) -> Any:
    """Return the last request of a class; None if there was none."""
    return chassis.last(full_name(cls))


def velocities(chassis: SimulatorThread, begin: int = 0) -> list[Twist]:
    """Return the velocities among the requests from a number on."""
    name = full_name(Twist)
    return [each.message for each in chassis.received[begin:] if each.type == name]


def is_emergency_stopped(parts: dict[str, Any]) -> bool:
    return bool(parts["robot"]["objections"][0]["name"] == "emergency_stop")


def is_driving(chassis: SimulatorThread) -> bool:
    return chassis.state.velocity.forward > 0.05


def is_stopped_by_zero(chassis: SimulatorThread) -> bool:
    return last(chassis, Twist) == Twist() and chassis.state.velocity.forward == 0.0


def say(text: dict[str, Any]) -> str:
    """Return in English what the dashboard says."""
    return str(text["english"])


class Page:
    """A page without a browser: the last data of each part, and what it was told."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.parts: dict[str, Any] = {}
        self.replies: dict[int, tuple[bool, str]] = {}
        self.data: dict[int, Any] = {}
        """What came with the replies."""
        self.refusals: list[str] = []
        """Reasons why the stick does not drive."""
        self.press = 0
        """Number of the current press of the stick."""
        self._pieces: dict[str, str] = {}
        self._commands = 0
        self.scans = 0
        self._changed = asyncio.Event()
        self.reader = asyncio.ensure_future(self._read())

    async def _read(self) -> None:
        async for message in self.socket:
            if isinstance(message, bytes):
                self.parts["scan"] = message
                self.scans += 1
            else:
                head, _, piece = message.partition("\n")
                content = json.loads(head)
                if piece:  # of a large part
                    known = self._pieces.get(content["part"], "") if content["begin"] else ""
                    self._pieces[content["part"]] = known + piece
                    if not content["last"]:
                        continue
                    content = json.loads(known + piece)
                if content["part"] == "reply":
                    self.replies[content["id"]] = content["ok"], say(content["text"])
                    self.data[content["id"]] = content["data"]
                else:
                    self.parts[content["part"]] = content["data"]
                    if content["part"] == "stick":
                        self.refusals.append(say(content["data"]))
            self._changed.set()

    async def until(self, wanted: Callable[[dict[str, Any]], Any]) -> Any:
        """Wait until `wanted` returns something for the parts; return that."""

        async def wait() -> Any:
            while True:
                try:
                    if found := wanted(self.parts):
                        return found
                except (IndexError, KeyError, TypeError):
                    pass  # the part has not come yet, or is None
                self._changed.clear()
                await self._changed.wait()

        return await asyncio.wait_for(wait(), TIMEOUT)

    async def ready(self) -> None:
        """Wait until the dashboard is connected to the robot and knows its state."""
        await self.until(lambda parts: parts["link"]["good"] and parts["robot"]["known"])

    async def passed(self, seconds: float) -> None:
        """Wait until so much time has passed for the dashboard."""
        begin = await self.until(lambda parts: parts["clock"])
        await self.until(lambda parts: parts["clock"] > begin + 1000 * seconds)

    async def send(self, **message: Any) -> None:
        await self.socket.send(json.dumps(message))

    async def command(self, name: str, **args: Any) -> tuple[bool, str]:
        """Send a command, and wait for the reply.

        On a busy machine, the connection to the dashboard or to the robot may be too slow for a
        moment. Places are on the map that the robot uses, unless `args` name another one.
        """
        if name in ("go", "goMark", "setPose"):
            used = await self.until(lambda parts: parts["robot"])
            args = {**{name: used[name] for name in ("scene", "map", "version")}, **args}
        while True:
            clock = await self.until(lambda parts: parts.pop("clock", 0))
            reply = await self.command_at(clock, name, **args)
            if TOO_SLOW not in reply[1] and "not sent: no data" not in reply[1]:
                return reply

    async def command_at(self, clock: int, name: str, **args: Any) -> tuple[bool, str]:
        """Send a command with this time, the newest one that the page knew; return the reply."""
        self._commands += 1
        number = self._commands
        await self.send(do="command", id=number, name=name, args=args, clock=clock)
        return await self.until(lambda _: self.replies.get(number))

    async def give(self, name: str, **args: Any) -> str:
        """Send a command that must be accepted; return the text of the reply."""
        ok, text = await self.command(name, **args)
        assert ok, text
        return text

    async def refused(self, name: str, **args: Any) -> str:
        """Send a command that must be refused; return the text of the reply."""
        ok, text = await self.command(name, **args)
        assert not ok
        return text

    async def drive(self, linear: float, angular: float = 0.0, **changed: Any) -> None:
        """Send one velocity of the stick; `changed` replaces the time or the press."""
        clock = await self.until(lambda parts: parts["clock"])
        velocity = {"linear": linear, "angular": angular, "press": self.press, "clock": clock}
        await self.send(**{"do": "drive", **velocity, **changed})

    @asynccontextmanager
    async def holds(
        self, linear: float, angular: float = 0.0, again: Sequence[str] = MOMENTARY
    ) -> AsyncIterator[None]:
        """Press the stick and hold it; press it again only after a refusal for a reason `again`."""
        self.press += 1
        held = True

        async def repeat() -> None:
            known = len(self.refusals)
            while held:
                if any(reason in each for each in self.refusals[known:] for reason in again):
                    known = len(self.refusals)
                    self.press += 1
                await self.drive(linear, angular)
                await asyncio.sleep(0.05)

        holding = asyncio.ensure_future(repeat())
        try:
            yield
        finally:
            held = False  # before Python 3.12, `wait_for` may swallow a cancellation
            holding.cancel()
            await asyncio.gather(holding, return_exceptions=True)

    async def closed(self) -> int:
        """Wait until the dashboard has closed the connection; return the code."""
        await asyncio.wait_for(self.socket.wait_closed(), TIMEOUT)
        return int(self.socket.close_code)


@asynccontextmanager
async def page(
    running: Dashboard | str, port: int = 0, tls: ssl.SSLContext | None = None, **headers: str
) -> AsyncIterator[Page]:
    """Open a page, directly or at the port of `delayed`; `headers` replace those of a browser."""
    host = f"127.0.0.1:{port}" if port else place(running)
    options = {_HEADERS_OPTION: {"Origin": f"http{'s' if tls else ''}://{host}", **headers}}
    if tls:
        options["ssl"] = tls
    url = f"ws{'s' if tls else ''}://{host}/live"
    connect = Connect(url, factory=Socket, compression=None, **options)
    async with connect as socket:
        opened = Page(socket)
        try:
            yield opened
        finally:
            opened.reader.cancel()


@asynccontextmanager
async def controlled(*robots: SimulatorThread, **options: Any) -> AsyncIterator[Page]:
    """Open a page with control that is ready; see `dashboard`."""
    async with dashboard(*robots, control=True, **options) as running, page(running) as viewer:
        await viewer.ready()
        yield viewer


@asynccontextmanager
async def controlled_by_two(
    *robots: SimulatorThread, **options: Any
) -> AsyncIterator[tuple[Page, Page]]:
    """Open two pages with control that are ready; see `dashboard`."""
    async with (
        dashboard(*robots, control=True, **options) as running,
        page(running) as first,
        page(running) as second,
    ):
        await first.ready()
        await second.ready()
        yield first, second


@dataclass
class Delay:
    """Time that data take to and from the dashboard, in seconds.

    Attributes:
        rate: maximum rate of the data from the dashboard, in bytes per second.
    """

    there: float = 0.0
    back: float = 0.0
    rate: float = math.inf


@asynccontextmanager
async def delayed(running: Dashboard | str, delay: Delay) -> AsyncIterator[int]:
    """Forward a port to a dashboard, with a delay that may be changed meanwhile."""
    loop = asyncio.get_running_loop()

    async def pass_on(
        reader: asyncio.StreamReader,
        transport: Any,
        seconds: Callable[[], float],
        rate: Callable[[], float] = lambda: math.inf,
    ) -> None:
        while data := await reader.read(4096):
            await asyncio.sleep(len(data) / rate())
            loop.call_later(seconds(), transport.write, data)

    async def forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        host, port = place(running).split(":")
        there = socket.socket()
        there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # data wait at their sender
        there.setblocking(False)
        await loop.sock_connect(there, (host, int(port)))
        there_reader, there_writer = await asyncio.open_connection(sock=there, limit=4096)
        ways = (
            asyncio.ensure_future(pass_on(reader, there_writer.transport, lambda: delay.there)),
            asyncio.ensure_future(
                pass_on(there_reader, writer.transport, lambda: delay.back, lambda: delay.rate)
            ),
        )
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way, end in zip(ways, (there_writer, writer), strict=True):
                way.cancel()
                end.transport.abort()

    async with await asyncio.start_server(forward, "127.0.0.1", 0) as server:
        yield server.sockets[0].getsockname()[1]
