"""The port of the page: HTTP and WebSockets together, and who may open them."""

from __future__ import annotations

import asyncio
import hmac
import http
import ipaddress
import math
import re
import secrets
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from types import MappingProxyType
from typing import Any
from urllib.parse import SplitResult, parse_qs, urlsplit

from woosh_robot_agent.link.transport import serve

_OPEN_TIMEOUT = 5.0
"""Time in which a browser must have sent its request, in seconds."""
_BASE: Any
_TIMEOUT_OPTION: dict[str, Any]
try:  # websockets 13 and later
    from websockets.asyncio.server import ServerConnection as _BASE

    _FACTORY_OPTION, _TIMEOUT_OPTION = "create_connection", {"open_timeout": _OPEN_TIMEOUT}
except ImportError:
    from websockets.legacy.server import WebSocketServerProtocol as _BASE

    _FACTORY_OPTION, _TIMEOUT_OPTION = "create_protocol", {}

_CLOSE_TIMEOUT = 1.0
"""Timeout of the closing handshake, in seconds."""
_PING_INTERVAL = 3.0
"""Time between two pings of a browser, in seconds."""
_PING_TIMEOUT = 10.0
"""Time without the answer to a ping after which the browser counts as gone, in seconds."""
_FRAME_RATE = 60.0
"""Rate of frames that a browser may send for long, in Hz."""
_FRAME_BURST = 120.0
"""Number of frames that a browser may send at once."""
_MAX_OPENING = 64
"""Maximum number of connections that have not opened a WebSocket."""
_MAX_METHOD = 8
"""Length from which the beginning of a request is not that of a method."""
_METHOD_NOT_ALLOWED = (
    b"HTTP/1.1 405 Method Not Allowed\r\nAllow: GET, HEAD\r\nContent-Length: 0\r\n"
    b"Connection: close\r\n\r\n"
)
POLICY_VIOLATION = 1008
"""Code with which a WebSocket is closed if the browser breaks a limit."""


@dataclass(frozen=True)
class Request:
    """The first lines of an HTTP request.

    Attributes:
        target: path with the query, as sent.
        headers: values by name in lower case; of a repeated header, None.
    """

    target: str
    headers: Mapping[str, str | None]

    @property
    def path(self) -> str:
        """Path without the query; empty if it is not valid."""
        return self._parts.path

    @property
    def query(self) -> dict[str, str]:
        """First value of each argument of the query."""
        return {name: values[0] for name, values in parse_qs(self._parts.query).items()}

    @property
    def _parts(self) -> SplitResult:
        try:
            return urlsplit(self.target)
        except ValueError:
            return SplitResult("", "", "", "", "")


@dataclass(frozen=True)
class Response:
    """An HTTP response.

    Attributes:
        status: the status.
        body: the content.
        content_type: the media type of the content.
        headers: further headers.
    """

    status: http.HTTPStatus
    body: bytes = b""
    content_type: str = "text/plain; charset=utf-8"
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def all_headers(self) -> list[tuple[str, str]]:
        """The headers as sent."""
        return [
            ("Content-Type", self.content_type),
            ("Content-Length", str(len(self.body))),
            ("Connection", "close"),
            *self.headers.items(),
        ]


Respond = Callable[[Request], "Response | None"]
"""Returns the response to a request; None opens a WebSocket."""


async def serve_http(
    respond: Respond,
    handle: Callable[[Any], Awaitable[None]],
    host: str,
    port: int,
    max_size: int,
) -> Any:
    """Listen for browsers.

    Args:
        respond: answers each request.
        handle: serves one WebSocket of `websockets`.
        host: address to listen on.
        port: port to listen on; 0 takes a free one.
        max_size: largest message that is read from a WebSocket, in bytes.

    Returns:
        The server of `websockets`.

    Raises:
        OSError: it cannot listen there.
    """
    connection_class = _limited(_BASE)

    async def handle_opened(connection: Any) -> None:
        connection.opened()
        await handle(connection)

    return await serve(
        handle_opened,
        host,
        port,
        process_request=_process_request(respond),
        max_size=max_size,
        max_queue=16,
        compression=None,
        close_timeout=_CLOSE_TIMEOUT,
        ping_interval=_PING_INTERVAL,
        ping_timeout=_PING_TIMEOUT,
        **{_FACTORY_OPTION: connection_class},
        **_TIMEOUT_OPTION,
    )


def _limited(base: Any) -> Any:
    """Return a class of connections, derived from that of `websockets`, with limits.

    1. Only GET and HEAD are answered.
    2. Of the connections that are no WebSockets (yet), only the newest `_MAX_OPENING` are kept.
    3. The number of frames is limited. Pings and fragments, which the reader of messages never
       sees, count as well; a browser sends small messages in one piece.
    """
    opening: dict[Any, None] = {}

    class LimitedConnection(base):
        is_head = False
        """True if the response has no body, because the method is HEAD."""
        _start: bytes | None = b""
        """Beginning of the request until its method is known, and None from then on."""
        _allowance = _FRAME_BURST
        _counted_at = -math.inf

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            opening[self] = None
            if len(opening) > _MAX_OPENING:
                oldest = next(iter(opening))
                oldest.opened()
                oldest.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            self.opened()
            super().connection_lost(exc)

        def opened(self) -> None:
            """Count as a WebSocket from now on."""
            opening.pop(self, None)

        def data_received(self, data: bytes) -> None:
            if self.transport.is_closing():
                return
            if self._start is not None:
                self._start += data
                method, space, rest = self._start.partition(b" ")
                if not space and len(method) < _MAX_METHOD:
                    return
                data, self._start = self._start, None
                if method == b"HEAD":
                    self.is_head, data = True, b"GET " + rest  # `websockets` knows only GET
                elif method != b"GET":
                    self.transport.write(_METHOD_NOT_ALLOWED)
                    self.transport.close()
                    return
            super().data_received(data)

        def process_event(self, event: Any) -> None:  # called by websockets 13 and later
            if self.request is not None and (reason := self._excess(event)):
                self.protocol.fail(POLICY_VIOLATION, reason)
                self.send_data()
            else:
                super().process_event(event)

        async def read_frame(self, max_size: int | None) -> Any:  # called before websockets 13
            frame = await super().read_frame(max_size)
            if reason := self._excess(frame):
                self.fail_connection(POLICY_VIOLATION, reason)
                await asyncio.sleep(0)  # it has cancelled this task
            return frame

        def _excess(self, frame: Any) -> str:
            """Count a frame; return the reason why it is one too many, or an empty text."""
            now = asyncio.get_running_loop().time()
            gained = (now - self._counted_at) * _FRAME_RATE
            self._allowance = min(_FRAME_BURST, self._allowance + gained) - 1.0
            self._counted_at = now
            if self._allowance < 0.0:
                return "too many messages"
            return "" if frame.fin else "a message in fragments"

        def write_http_response(  # called before websockets 13
            self, status: Any, headers: Any, body: bytes | None = None
        ) -> None:
            super().write_http_response(status, headers, None if self.is_head else body)

    return LimitedConnection


def _process_request(respond: Respond) -> Callable[..., Any]:
    """Return the function that `websockets` calls with each request."""
    if _FACTORY_OPTION == "create_protocol":  # before websockets 13

        async def process_legacy(path: str, headers: Any) -> Any:
            response = respond(_request(path, headers))
            if response is None:
                return None
            return response.status, response.all_headers, response.body

        return process_legacy

    from websockets.datastructures import Headers
    from websockets.http11 import Response as RawResponse

    async def process(connection: Any, request: Any) -> Any:
        response = respond(_request(request.path, request.headers))
        if response is None:
            return None
        status = response.status
        headers = Headers(response.all_headers)
        body = b"" if connection.is_head else response.body
        return RawResponse(status.value, status.phrase, headers, body)

    return process


def _request(target: str, headers: Any) -> Request:
    values: dict[str, str | None] = {}
    for name, value in headers.raw_items():
        values[name.lower()] = None if name.lower() in values else value
    return Request(target, values)


SECURITY_HEADERS = MappingProxyType(
    {
        "Content-Security-Policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
            "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cache-Control": "no-store",
    }
)
"""Headers of each response: the page loads nothing from other hosts, and no other one embeds it."""
_TOKEN_BYTES = 16
"""Length of a token, in random bytes."""
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[\w.-]+)(:\d{1,5})?", re.ASCII | re.IGNORECASE)
"""A host with an optional port, and without the user name that URLs may have."""


class Access:
    """Decides which requests are answered.

    1. A page of another site cannot read or command anything: WebSockets need the origin of the
       page itself. On this machine, the `Host` header must name this machine, so that no other
       site's name can be redirected here.
    2. If other machines can connect, every request needs the token: from the printed address, and
       then from the cookie that the page sets.

    Args:
        host: the address that is listened on.

    Attributes:
        token: the token that requests need; empty if only this machine can connect.
        port: port that is listened on, known once the server listens.
    """

    def __init__(self, host: str) -> None:
        self.token = "" if is_local(host) else secrets.token_urlsafe(_TOKEN_BYTES)
        self.port = 0

    def refusal(self, request: Request) -> str:
        """Return the reason why a request is refused, and what to do; empty if it is answered."""
        host = request.headers.get("host")
        if not host or not _HOST.fullmatch(host):
            return "the request has no valid Host header"
        if not self.token and not _names_this_machine(host):
            return f"open this page at http://127.0.0.1:{self.port}, not by another name"
        if self.token and not self._has_token(request):
            return "the address needs the token: use the address that the program printed"
        return ""

    def socket_refusal(self, request: Request) -> str:
        """Return the reason why a WebSocket is refused; empty if it is opened."""
        if reason := self.refusal(request):
            return reason
        if request.headers.get("origin") != f"http://{request.headers['host']}":
            return "only the page of this program may connect"
        return ""

    def cookie(self, request: Request) -> str:
        """Return the cookie that the page needs for its own requests; empty if none."""
        if not self.token or not self._is_token(request.query.get("token", "")):
            return ""
        return f"{self._cookie_name}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    @property
    def _cookie_name(self) -> str:
        return f"woosh_dashboard_{self.port}"  # browsers send cookies to all ports of a host

    def _has_token(self, request: Request) -> bool:
        if self._is_token(request.query.get("token", "")):
            return True
        try:
            cookies = SimpleCookie(request.headers.get("cookie") or "")
        except CookieError:
            return False
        return self._cookie_name in cookies and self._is_token(cookies[self._cookie_name].value)

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self.token.encode())


def is_local(host: str) -> bool:
    """Return True if only this machine can reach an address that is listened on."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _names_this_machine(host: str) -> bool:
    """Return True if a `Host` header names this machine."""
    try:
        name = urlsplit(f"//{host}").hostname
    except ValueError:
        return False
    return name is not None and is_local(name)
