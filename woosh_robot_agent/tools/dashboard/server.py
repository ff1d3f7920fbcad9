"""The server of the page: files, map pictures, and a WebSocket for each viewer."""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import mimetypes
import socket
import ssl
import uuid
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

from aiohttp import WSCloseCode, WSMsgType, web

from woosh_robot_agent.link import LinkConfig, LinkError
from woosh_robot_agent.link.server import Listener
from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.access import (
    SECURITY_HEADERS,
    Access,
    LimitedConnection,
    Role,
    new_tokens,
)
from woosh_robot_agent.tools.dashboard.commands import COMMANDS, Args, CommandError
from woosh_robot_agent.tools.dashboard.control import STOP, Control, ControlConfig, Outcome
from woosh_robot_agent.tools.dashboard.parts import Parts
from woosh_robot_agent.tools.dashboard.robot import READ_ONLY, Robot
from woosh_robot_agent.tools.dashboard.texts import PAGE, page_text, translated, value_data
from woosh_robot_agent.tools.dashboard.viewer import Viewer
from woosh_robot_agent.tools.options import own_address

_LOG = logging.getLogger(__name__)
_METHODS = ("GET", "HEAD")
_ONLY_GET = Sentence("only GET")
_NO_PAGE = Sentence("there is no such page")
mimetypes.add_type("text/javascript", ".js")  # some systems say something else
_SILENT = logging.getLogger(f"{__name__}.http")
"""Logger of aiohttp. It is off, because aiohttp logs every request that it cannot parse, so that a
port scan would fill the log."""
_SILENT.disabled = True
_MAX_MESSAGE = 4096
"""Largest message that is read from a page, in bytes."""
_MAX_VIEWERS = 20
"""Maximum number of viewers, in addition to one for each robot, which controls it."""
_MAX_COMMANDS = 8
"""Maximum number of commands of one viewer that wait for answers. What only ends or interrupts a
motion is always allowed."""
_MAX_CLOCK = 10**15
"""Greatest time in a message of the page, in milliseconds."""
_PLACES_PERIOD = 0.2
"""Minimum time between two messages with the places of the other robots, in seconds."""
_CLOCK_PERIOD = 0.1
"""Time between two messages to the viewers with the time of this process, in seconds."""
_HEARTBEAT = 8.0
"""Silence of a page after which it is pinged, in seconds; it must answer within half this time."""
_KEEPALIVE_TIMEOUT = 10.0
"""Time for which an idle connection is kept open for further requests, in seconds."""
_CLOSE_TIMEOUT = 1.0
"""Timeout of the closing handshake, in seconds."""
_TOO_MANY_VIEWERS = "there are too many viewers; reload the page to come back"


@dataclass(frozen=True)
class DashboardConfig:
    """Options of a dashboard.

    Attributes:
        host: address to listen on.
        port: port to listen on; 0 takes a free port.
        tls: certificate for HTTPS; None for HTTP.
        control: True if viewers may command the robots.
        tokens: token of each role, used only if other machines can connect.
        control_config: limits and timeouts of the control.
        scan_rate: rate at which laser scans are requested while somebody watches, in Hz.
    """

    host: str = "127.0.0.1"
    port: int = 8480
    tls: ssl.SSLContext | None = None
    control: bool = False
    tokens: dict[Role, str] = field(default_factory=new_tokens)
    control_config: ControlConfig = field(default_factory=ControlConfig)
    scan_rate: float = 10.0


class Dashboard:
    """A page that shows robots, at a port. Runs in the current event loop.

    Args:
        more_commands: functions for further commands of the page, e.g. for a simulator, by name.
            They take the arguments of the command.
    """

    def __init__(
        self,
        robots: Sequence[LinkConfig],
        config: DashboardConfig,
        more_commands: Mapping[str, Callable[[Args], Outcome]] | None = None,
    ) -> None:
        self._config = config
        self._more_commands = more_commands or {}
        self._access = Access(
            config.host,
            is_encrypted=config.tls is not None,
            control=config.control,
            tokens=config.tokens,
        )
        self._files = _page_files()
        self._shared = Parts()
        self._shared.add("fleet", self._fleet_data, on_change=False, each_second=True)
        # each second, too, because places disappear when a robot is lost or silent
        self._shared.add("places", self._places_data, each_second=True)
        self.robots = [
            Robot(each, self._shared, control=config.control, scan_rate=config.scan_rate)
            for each in robots
        ]
        self._controls = {
            each: Control(each, config.control_config, lambda: self._shared.publish("fleet"))
            for each in self.robots
        }
        self._viewers: set[Viewer] = set()
        self._viewer_count = 0
        """Number of viewers accepted so far."""
        self._process = uuid.uuid4().hex
        """Tells the page whether it is connected to another process than before."""
        content = b"".join(sorted(content for content, _ in self._files.values()))
        self._page = hashlib.sha256(content).hexdigest()
        """Tells the page whether its files have changed since it was opened."""
        self._opening: dict[LimitedConnection, None] = {}
        """Connections that are not WebSockets (yet), the oldest first, as an ordered set."""
        self._listener: Listener | None = None
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Dashboard:
        await self.start()
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.close()

    async def start(self) -> None:
        """Start listening, and connecting to the robots.

        Raises:
            OSError: the server cannot listen at the address.
        """
        loop, config = asyncio.get_running_loop(), self._config
        http = web.Server(
            self._respond,
            logger=_SILENT,
            access_log=None,
            keepalive_timeout=_KEEPALIVE_TIMEOUT,
            lingering_time=0.0,
        )
        server = await loop.create_server(
            lambda: LimitedConnection(http(), self._opening),
            config.host,
            config.port,
            ssl=config.tls,
        )
        self._listener = Listener(server, http)
        self._access.port = self._listener.port
        for robot in self.robots:
            robot.start()
        for robot, control in self._controls.items():
            control.start().add_done_callback(partial(self._show_failure, [robot]))
        for work in (
            self._tell_time(),
            self._shared.publish_changes(_PLACES_PERIOD),
            self._shared.publish_each_second(),
        ):
            task = loop.create_task(work, name="dashboard")
            task.add_done_callback(partial(self._show_failure, self.robots))
            self._tasks.append(task)

    def _show_failure(self, robots: Iterable[Robot], task: asyncio.Task[None]) -> None:
        """Show on the pages of these robots that a task for them has failed."""
        if not task.cancelled() and (error := task.exception()):
            _LOG.error("the page is no longer updated; restart the dashboard", exc_info=error)
            for robot in robots:
                robot.show_failure()

    async def close(self) -> None:
        """Stop each robot that a stick drives, stop listening, and close the links."""
        await asyncio.gather(*map(self._stop_driving, self._controls))
        for task in self._tasks:
            task.cancel()
        for viewer in self._viewers:
            viewer.dismiss(WSCloseCode.GOING_AWAY, "the dashboard has ended")
        if self._listener is not None:
            await self._listener.close()
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
        """Address of the page, with the token of the highest role, if tokens are needed."""
        return self.urls[Role.CONTROL if self._config.control else Role.LOOK]

    @property
    def urls(self) -> dict[Role, str]:
        """Address of the page for each role; the same address if no token is needed."""
        host = _reachable(self._config.host)
        shown = f"[{host}]" if ":" in host else host
        page = f"{self._access.scheme}://{shown}:{self._access.port}/"
        tokens = self._access.tokens
        if not tokens:
            return dict.fromkeys(Role, page)
        return {role: f"{page}?token={quote(token, safe='')}" for role, token in tokens.items()}

    # Parts of all robots

    def _fleet_data(self) -> list[dict[str, Any]]:
        return [
            {
                **part_data.card_data(each.view, each.chassis, each.silence),
                "link": each.link_state,
                "order": each.order(),
                "task": control.tasks.running(),
                "alarm": value_data(control.alarm.reason),
                "speedLimit": control.speed_limit,
            }
            for each, control in self._controls.items()
        ]

    def _places_data(self) -> list[dict[str, Any]]:
        if len(self.robots) == 1:
            return []
        places = (
            part_data.place_data(each.view.info, index)
            for index, each in enumerate(self.robots)
            if each.is_live
        )
        return [each for each in places if each is not None]

    # HTTP

    async def _respond(self, request: web.BaseRequest) -> web.StreamResponse:
        """Answer a request; log an unexpected error, because the logger of aiohttp is off."""
        try:
            return await self._answer(request)
        except (web.HTTPException, ConnectionError):  # a bad handshake, or the browser has gone
            raise
        except Exception:
            _LOG.exception("the request %s failed", request.path)
            raise

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        if request.method not in _METHODS:
            allowed = ", ".join(_METHODS)
            return _error(request, HTTPStatus.METHOD_NOT_ALLOWED, _ONLY_GET(), Allow=allowed)
        is_socket, access = request.path == "/live", self._access
        if reason := access.socket_refusal(request) if is_socket else access.refusal(request):
            return _error(request, HTTPStatus.FORBIDDEN, reason)
        if is_socket:
            return await self._serve(request)
        found = self._files.get(request.path) or self._map_picture(request.path)
        if found is None:
            return _error(request, HTTPStatus.NOT_FOUND, _NO_PAGE())
        content, content_type = found
        headers = {**SECURITY_HEADERS, "Content-Type": content_type}
        response = web.Response(body=content, headers=headers)
        access.set_cookie(request, response)
        return response

    def _map_picture(self, path: str) -> tuple[bytes, str] | None:
        """Return a picture of the map of a robot, and its content type; None if there is none.

        Its path is `/map/ROBOT/NUMBER.png`, or for the keep-out areas `/keepout/ROBOT/NUMBER.png`.
        ROBOT is the index of the robot.
        NUMBER is ignored: it gives each picture its own path, so that the browser loads it.
        """
        for index, robot in enumerate(self.robots):
            picture = robot.map.picture
            if picture is None:
                continue
            if path.startswith(f"/map/{index}/"):
                return picture.png, "image/png"
            if path.startswith(f"/keepout/{index}/") and picture.keepout_png:
                return picture.keepout_png, "image/png"
        return None

    # WebSockets

    async def _serve(self, request: web.BaseRequest) -> web.WebSocketResponse:
        """Serve a viewer until it disconnects or is dismissed; refuse it if there is no room."""
        socket = web.WebSocketResponse(
            timeout=_CLOSE_TIMEOUT,
            heartbeat=_HEARTBEAT,
            max_msg_size=_MAX_MESSAGE,
            compress=False,
        )
        await socket.prepare(request)
        transport = request.transport
        if transport is None:  # the viewer has disconnected already
            return socket
        connection = transport.get_protocol()
        assert isinstance(connection, LimitedConnection)
        connection.opened()
        if not self._make_room():
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many viewers")
            return socket
        self._viewer_count += 1
        may_control = self._access.role(request) is Role.CONTROL
        viewer = Viewer(
            socket,
            transport,
            connection.is_writable,
            self._viewer_count,
            self._shared,
            self.robots[0],
            may_control=may_control,
        )
        self._viewers.add(viewer)
        viewer.note(part="hello", data=self._hello(viewer))
        self._watch(viewer, 0)
        sending = asyncio.get_running_loop().create_task(viewer.send(), name="viewer")
        try:
            async for message in socket:
                viewer.heard_at = asyncio.get_running_loop().time()
                if message.type is not WSMsgType.TEXT:
                    raise ValueError("not a message of the page")
                self._handle(viewer, _parse(message.data))
            # aiohttp closes the WebSocket when this returns, without the reason of `dismiss`
            await viewer.wait_dismissed()
        except ValueError as error:
            _LOG.debug("%s is disconnected: %s", viewer.name, error)
            await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=str(error)[:100].encode())
        finally:
            self._leave(viewer)
            sending.cancel()
        return socket

    def _make_room(self) -> bool:
        """Disconnect a viewer without control if there are too many: if possible, a hidden one.

        A new viewer is let in, because it may have to stop a robot.

        Returns:
            False if there is no room, because each viewer has the control of a robot.
        """
        if len(self._viewers) < _MAX_VIEWERS + len(self.robots):
            return True
        owners = {control.owner for control in self._controls.values()}
        idle = [viewer for viewer in self._viewers if viewer not in owners]
        if not idle:
            return False
        oldest = min(idle, key=lambda viewer: (viewer.visible, viewer.heard_at))
        self._leave(oldest)
        oldest.dismiss(WSCloseCode.TRY_AGAIN_LATER, _TOO_MANY_VIEWERS)
        return True

    def _leave(self, viewer: Viewer) -> None:
        """Forget a viewer, and take the control from it; idempotent."""
        self._release(viewer)
        viewer.unwatch()
        self._viewers.discard(viewer)

    async def _tell_time(self) -> None:
        while True:
            for viewer in self._viewers:
                viewer.tell_time()
            await asyncio.sleep(_CLOCK_PERIOD)

    def _hello(self, viewer: Viewer) -> dict[str, Any]:
        return {
            "process": self._process,
            "page": self._page,
            "now": part_data.now(),
            "you": viewer.name,
            "control": viewer.may_control,
            "robots": [robot.chassis.config.address for robot in self.robots],
        }

    def _watch(self, viewer: Viewer, index: int) -> None:
        viewer.note(part="watching", data=index)  # the following parts are of this robot
        viewer.watch(self.robots[index])

    def _release(self, viewer: Viewer) -> None:
        for control in self._controls.values():
            control.release(viewer)

    def _handle(self, viewer: Viewer, message: Any) -> None:
        """Handle one message.

        Raises:
            ValueError: not a message that the page sends, or one that the viewer may not send.
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
            case {"do": "drive"} if viewer.may_control:
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

    def _start_command(
        self, viewer: Viewer, id_: int, name: str, args: dict[str, Any], clock: int
    ) -> None:
        """Start a command of a viewer for the robot that it watches now."""
        try:
            interrupts = name == STOP or (name in COMMANDS and COMMANDS[name].interrupts)
            if len(viewer.commands) >= _MAX_COMMANDS and not interrupts:
                raise CommandError(page_text("reason.tooManyCommands"))
            execution = self._execution(viewer, name, args, clock)
        except CommandError as error:
            self._reply(viewer, id_, Outcome(False, said_by(error)))
            return

        async def execute() -> None:
            self._reply(viewer, id_, await execution)

        task = asyncio.get_running_loop().create_task(execute(), name=name)
        viewer.commands.add(task)
        task.add_done_callback(viewer.commands.discard)

    def _reply(self, viewer: Viewer, id_: int, outcome: Outcome) -> None:
        ok, text, data = outcome
        viewer.note(part="reply", id=id_, ok=ok, text=value_data(text), data=data)

    def _execution(
        self, viewer: Viewer, name: str, args: Args, clock: int
    ) -> Coroutine[Any, Any, Outcome]:
        """Return the execution of a command for the robot that the viewer watches.

        `clock` is the newest time of this process that the page had received, in milliseconds.

        Raises:
            CommandError: the command is refused.
        """
        robot = viewer.robot
        if name == "history":
            return self._history(robot)
        if not viewer.may_control:
            raise CommandError(page_text("reason.lookOnly") if self._config.control else READ_ONLY)
        if name in self._more_commands:
            return self._run_more(name, args)
        if name == "plan":
            return self._plan(robot, args)
        return self._controls[robot].command(viewer, name, args, clock)

    async def _history(self, robot: Robot) -> Outcome:
        return Outcome(True, page_text("reply.done"), {"samples": robot.samples})

    async def _plan(self, robot: Robot, args: Args) -> Outcome:
        try:
            return Outcome(True, page_text("reply.done"), await robot.plan(args))
        except (CommandError, LinkError) as error:
            return Outcome(False, page_text("reason.said", text=said_by(error)))

    async def _run_more(self, name: str, args: Args) -> Outcome:
        """Run one of `more_commands`, and show the viewers its effect."""
        outcome = self._more_commands[name](args)
        # only the dashboard of a simulator has such commands, and it shows only one robot
        self.robots[0].parts.changed()
        return outcome


def _reachable(host: str) -> str:
    """Return the address at which other machines reach a server that listens on `host`.

    For the wildcard address, that is the address of this machine in its default network.
    """
    elsewhere = {"0.0.0.0": "192.0.2.1", "::": "2001:db8::1"}  # reserved for documentation
    if host not in elsewhere:
        return host
    try:
        return own_address(elsewhere[host], 9)
    except OSError:  # this machine has no network of this family
        return socket.gethostname()


def _parse(text: str) -> Any:
    """Parse a message of the page.

    Raises:
        ValueError: the text is not JSON, or is nested too deeply.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("not a message of the page") from None


def _page_files() -> dict[str, tuple[bytes, str]]:
    """Return content and media type of the files of the page, by path."""
    found = {}
    for file in PAGE.rglob("*.*"):
        content_type = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
        if content_type.startswith("text/"):
            content_type += "; charset=utf-8"
        found[f"/{file.relative_to(PAGE).as_posix()}"] = (file.read_bytes(), content_type)
    found["/"] = found["/index.html"]
    return found


def _error(request: web.BaseRequest, status: HTTPStatus, text: str, **headers: str) -> web.Response:
    shown = translated(text, request.headers.get("Accept-Language", ""))
    return web.Response(status=status, text=f"{shown}\n", headers={**SECURITY_HEADERS, **headers})
