"""The server of the page: files, map pictures, and a WebSocket for each viewer."""

from __future__ import annotations

import asyncio
import json
import logging
import mimetypes
import socket
from collections.abc import Coroutine, Mapping, Sequence, Set
from dataclasses import dataclass
from http import HTTPStatus
from importlib import resources
from types import TracebackType
from typing import Any, Protocol

from websockets.exceptions import ConnectionClosed

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.tools.dashboard.access import (
    POLICY_VIOLATION,
    SECURITY_HEADERS,
    Access,
    Request,
    Response,
    serve_http,
)
from woosh_robot_agent.tools.dashboard.commands import CommandError
from woosh_robot_agent.tools.dashboard.control import STOP, Control
from woosh_robot_agent.tools.dashboard.robot import READ_ONLY, Robot
from woosh_robot_agent.tools.dashboard.viewer import Viewer

_LOG = logging.getLogger(__name__)
_MAX_MESSAGE = 4096
"""Largest message that is read from a page, in bytes."""
_MAX_COMMANDS = 8
"""Maximum number of commands of one viewer that wait for their answer; a stop is never too many."""
_TRY_AGAIN_LATER = 1013
"""Code with which a WebSocket is closed if there are too many viewers."""
_MAX_CLOCK = 10**15
"""Greatest time in a message of the page, in milliseconds."""
_CLOCK_PERIOD = 0.1
"""Time between two messages to the viewers with the time of this process, in seconds."""
_SOCKET_PATH = "/live"
_MAP_PATH = "/map/"
mimetypes.add_type("text/javascript", ".js")  # some systems say something else


@dataclass(frozen=True)
class DashboardConfig:
    """Options of a dashboard.

    Attributes:
        host: address to listen on.
        port: port to listen on; 0 takes a free one.
        control: the page may command the robots.
        max_linear: maximum speed of the stick, in m/s.
        max_angular: maximum turning speed of the stick, in rad/s.
        scan_rate: rate at which laser scans are requested while somebody watches, in Hz.
        max_viewers: maximum number of viewers.
    """

    host: str = "127.0.0.1"
    port: int = 8480
    control: bool = False
    max_linear: float = 0.5
    max_angular: float = 0.8
    scan_rate: float = 10.0
    max_viewers: int = 20


class Extras(Protocol):
    """Commands of the page that are not for the robot, such as those for a simulator."""

    @property
    def names(self) -> Set[str]:
        """Names of the commands."""

    def data(self) -> Any:
        """Return the part `simulator` of the page."""

    async def run(self, name: str, args: Mapping[str, Any]) -> tuple[bool, str]:
        """Execute a command; return its success and a text for the viewer."""


class Dashboard:
    """A page that shows robots, at a port. Runs in the current event loop.

    Args:
        robots: address and timeouts of each robot.
        config: the options.
        extras: further commands, which belong to the first robot.

    Attributes:
        robots: the robots.
    """

    def __init__(
        self,
        robots: Sequence[LinkConfig],
        config: DashboardConfig,
        extras: Extras | None = None,
    ) -> None:
        self._config = config
        self._extras = extras
        self._access = Access(config.host)
        self._files = _page_files()
        self.robots = [
            Robot(each, control=config.control, scan_rate=config.scan_rate) for each in robots
        ]
        self._controls: dict[Robot, Control] = {}
        if config.control:
            limits = config.max_linear, config.max_angular
            self._controls = {each: Control(each, *limits) for each in self.robots}
        if extras is not None:
            self.robots[0].add_slow_part("simulator", extras.data)
        if len(self.robots) > 1:
            for robot in self.robots:
                robot.add_slow_part("robots", self._summaries)
        self._viewers: set[Viewer] = set()
        self._count = 0
        """Number of viewers so far."""
        self._server: Any = None
        self._clock: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Dashboard:
        await self.start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    async def start(self) -> None:
        """Start listening, and connecting to the robots.

        Raises:
            OSError: it cannot listen at the address.
        """
        config = self._config
        self._server = await serve_http(
            self._respond, self._serve, config.host, config.port, _MAX_MESSAGE
        )
        self._access.port = self._server.sockets[0].getsockname()[1]
        for robot in self.robots:
            robot.start()
        for control in self._controls.values():
            control.start()
        self._clock = asyncio.get_running_loop().create_task(self._tell_time(), name="clock")

    async def close(self) -> None:
        """Stop each robot that a stick drives, stop listening, and close the links."""
        await asyncio.gather(*map(self._stop_driving, self._controls))
        if self._clock is not None:
            self._clock.cancel()
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()
        await asyncio.gather(*(robot.close() for robot in self.robots))

    async def _stop_driving(self, robot: Robot) -> None:
        if reason := await self._controls[robot].close():
            _LOG.error(
                "the robot at %s was not stopped; if it moves, press its emergency stop: %s",
                robot.chassis.config.address,
                reason,
            )

    @property
    def url(self) -> str:
        """Address of the page, with the token if it needs one."""
        host = _reachable(self._config.host)
        shown = f"[{host}]" if ":" in host else host
        token = f"?token={self._access.token}" if self._access.token else ""
        return f"http://{shown}:{self._access.port}/{token}"

    # HTTP

    def _respond(self, request: Request) -> Response | None:
        """Return the response to a request; None opens a WebSocket."""
        if request.path == _SOCKET_PATH:
            reason = self._access.socket_refusal(request)
            return _refused(reason) if reason else None
        if reason := self._access.refusal(request):
            return _refused(reason)
        headers = dict(SECURITY_HEADERS)
        if cookie := self._access.cookie(request):
            headers["Set-Cookie"] = cookie
        if request.path.startswith(_MAP_PATH):
            found = self._map_picture(request.path.removeprefix(_MAP_PATH))
        else:
            found = self._files.get(request.path)
        if found is None:
            return _text(HTTPStatus.NOT_FOUND, "there is no such page")
        content, content_type = found
        return Response(HTTPStatus.OK, content, content_type, headers)

    def _map_picture(self, name: str) -> tuple[bytes, str] | None:
        """Return the map of a robot, by `ROBOT/NUMBER.png`; NUMBER only tells pictures apart."""
        number, _, _ = name.partition("/")
        index = {str(each): each for each in range(len(self.robots))}.get(number)
        picture = None if index is None else self.robots[index].map.picture
        return None if picture is None else (picture.png, "image/png")

    # WebSockets

    async def _serve(self, connection: Any) -> None:
        if len(self._viewers) >= self._config.max_viewers and not self._make_room():
            await connection.close(_TRY_AGAIN_LATER, "too many viewers")
            return
        self._count += 1
        viewer = Viewer(connection, self._count)
        self._viewers.add(viewer)
        viewer.note(part="hello", data=self._hello(viewer))
        self._watch(viewer, 0)
        sending = asyncio.get_running_loop().create_task(viewer.send(), name="viewer")
        try:
            await self._receive(connection, viewer)
        finally:
            self._leave(viewer)
            sending.cancel()

    def _make_room(self) -> bool:
        """Disconnect a viewer that does not drive, so that a new one can always come, and stop.

        Returns:
            False if all viewers have control.
        """
        idle = [viewer for viewer in self._viewers if not self._has_control(viewer)]
        if not idle:
            return False
        oldest = min(idle, key=lambda viewer: (viewer.visible, viewer.heard_at))
        self._leave(oldest)
        oldest.dismiss(_TRY_AGAIN_LATER, "there are too many viewers; reload the page to come back")
        return True

    def _has_control(self, viewer: Viewer) -> bool:
        return any(control.owner is viewer for control in self._controls.values())

    def _leave(self, viewer: Viewer) -> None:
        self._release(viewer)
        viewer.unwatch()
        self._viewers.discard(viewer)

    async def _receive(self, connection: Any, viewer: Viewer) -> None:
        """Handle the messages of a viewer until it leaves."""
        try:
            while True:
                text = await connection.recv()
                viewer.heard_at = asyncio.get_running_loop().time()
                self._handle(viewer, _parse(text))
        except ValueError as error:
            _LOG.debug("%s is disconnected: %s", viewer.name, error)
            await connection.close(POLICY_VIOLATION, str(error)[:100])
        except ConnectionClosed:
            return

    async def _tell_time(self) -> None:
        while True:
            for viewer in self._viewers:
                viewer.tell_time()
            await asyncio.sleep(_CLOCK_PERIOD)

    def _watch(self, viewer: Viewer, index: int) -> None:
        viewer.note(part="watching", data=index)  # the parts that follow are those of this robot
        viewer.watch(self.robots[index])

    def _hello(self, viewer: Viewer) -> dict[str, Any]:
        return {
            "you": viewer.name,
            "control": self._config.control,
            "robots": [robot.chassis.config.address for robot in self.robots],
        }

    def _summaries(self) -> list[str]:
        return [robot.summary for robot in self.robots]

    def _release(self, viewer: Viewer) -> None:
        for control in self._controls.values():
            control.release(viewer)

    def _start_command(
        self, viewer: Viewer, id_: int, name: str, args: dict[str, Any], clock: int
    ) -> None:
        """Start a command of a viewer for the robot that it watches now."""
        try:
            if len(viewer.commands) >= _MAX_COMMANDS and name != STOP:
                raise CommandError("wait for the other commands")
            work = self._work(viewer, name, args, clock)
        except CommandError as error:
            viewer.note(part="reply", id=id_, ok=False, text=str(error))
            return

        async def execute() -> None:
            ok, text = await work
            viewer.note(part="reply", id=id_, ok=ok, text=text)

        task = asyncio.get_running_loop().create_task(execute(), name=name)
        viewer.commands.add(task)
        task.add_done_callback(viewer.commands.discard)

    def _work(
        self, viewer: Viewer, name: str, args: dict[str, Any], clock: int
    ) -> Coroutine[Any, Any, tuple[bool, str]]:
        """Return the execution of a command.

        Raises:
            CommandError: the command is refused.
        """
        if self._extras is not None and name in self._extras.names:
            return self._run_extra(self._extras, name, args)
        if viewer.robot not in self._controls:
            raise CommandError(READ_ONLY)
        control = self._controls[viewer.robot]
        return control.stop() if name == STOP else control.command(viewer, name, args, clock)

    async def _run_extra(self, extras: Extras, name: str, args: dict[str, Any]) -> tuple[bool, str]:
        result = await extras.run(name, args)
        self.robots[0].changed()
        return result

    def _handle(self, viewer: Viewer, message: dict[str, Any]) -> None:
        """Handle one message.

        Raises:
            ValueError: the page of this program does not send such a message.
        """
        match message:
            case {"do": "watch", "robot": int(index)} if 0 <= index < len(self.robots):
                self._release(viewer)
                self._watch(viewer, index)
            case {"do": "visible", "visible": bool(visible)}:
                if not visible:
                    self._release(viewer)
                viewer.set_visible(visible)
            case {"do": "release"}:
                self._release(viewer)
            case {"do": "drive"} if viewer.robot in self._controls:
                self._controls[viewer.robot].drive(viewer, message)
            case {
                "do": "command",
                "id": int(id_),
                "name": str(name),
                "args": dict(args),
                "clock": int(clock),
            } if abs(clock) < _MAX_CLOCK:
                self._start_command(viewer, id_, name, args, clock)
            case _:
                raise ValueError("not a message of the page")


def _reachable(host: str) -> str:
    """Return an address at which other machines reach what listens on `host`.

    For the wildcard address, that is the address of this machine in its default network.
    """
    elsewhere = {"0.0.0.0": "192.0.2.1", "::": "2001:db8::1"}  # reserved for documentation
    if host not in elsewhere:
        return host
    family = socket.AF_INET if host == "0.0.0.0" else socket.AF_INET6
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((elsewhere[host], 9))  # sends nothing
        except OSError:  # there is no such network
            return socket.gethostname()
        return str(probe.getsockname()[0])


def _parse(text: str | bytes) -> dict[str, Any]:
    """Parse a message of the page.

    Raises:
        ValueError: it is not a JSON object.
    """
    try:
        message = json.loads(text)
    except RecursionError:
        raise ValueError("not a message of the page") from None
    if not isinstance(text, str) or not isinstance(message, dict):
        raise ValueError("not a message of the page")
    return message


def _page_files() -> dict[str, tuple[bytes, str]]:
    """Return content and media type of the files of the page, by path."""
    found = {}
    for file in resources.files(__package__).joinpath("page").iterdir():
        content_type = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
        if content_type.startswith("text/"):
            content_type += "; charset=utf-8"
        found[f"/{file.name}"] = (file.read_bytes(), content_type)
    found["/"] = found["/index.html"]
    return found


def _refused(reason: str) -> Response:
    return _text(HTTPStatus.FORBIDDEN, reason)


def _text(status: HTTPStatus, text: str) -> Response:
    return Response(status, f"{text}\n".encode(), headers=SECURITY_HEADERS)
