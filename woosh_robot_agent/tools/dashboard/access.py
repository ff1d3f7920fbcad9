"""Decide who may open the page, and limit how much a browser may send."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import math
import os
import re
import secrets
import socket
from enum import Enum
from http.cookies import CookieError
from pathlib import Path
from types import MappingProxyType
from urllib.parse import urlsplit

from aiohttp import web

from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.tools.options import ToolError, is_local

SECURITY_HEADERS = MappingProxyType(
    {
        "Content-Security-Policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
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
"""Headers of each response: the page loads nothing from other hosts, and no page may embed it."""
_NO_HOST = Sentence("the request has no valid Host header")
_OTHER_HOST = Sentence("open this page at {url}, not under another host name")
_NO_TOKEN = Sentence("the address needs a token: use an address that the program printed")
_OTHER_PAGE = Sentence("only the page of this program may connect")
_TOKEN_BYTES = 16
"""Length of a token, in random bytes."""
_MIN_TOKEN_LENGTH = 16
"""Minimum length of a token in a file, in characters."""
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[\w.-]+)(:\d{1,5})?", re.ASCII | re.IGNORECASE)
"""A host with an optional port, and without the user name that URLs may have."""


class Role(Enum):
    """Permission of a visitor of the page."""

    LOOK = "look"
    CONTROL = "control"


def new_tokens() -> dict[Role, str]:
    """Return a token for each role."""
    return {role: secrets.token_urlsafe(_TOKEN_BYTES) for role in Role}


def kept_tokens(path: Path) -> dict[Role, str]:
    """Return the tokens in a file, which is created with new tokens if it is missing.

    With such a file, the printed addresses stay valid when the program is started again.

    Raises:
        ToolError: the file cannot be read or made, others can read it, or it has no tokens.
    """
    try:
        with contextlib.suppress(FileExistsError):
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "w") as file:
                json.dump({role.value: token for role, token in new_tokens().items()}, file)
        if path.stat().st_mode & 0o077:
            raise ToolError(f"others can read {path}: run chmod 600 {path}")
        content = json.loads(path.read_text("utf-8"))
        tokens = {role: content[role.value] for role in Role}
    except OSError as error:
        raise ToolError(f"cannot use {path}: {error.strerror or error}") from None
    except (ValueError, TypeError, KeyError):
        tokens = {}
    if not tokens or not all(
        isinstance(each, str) and len(each) >= _MIN_TOKEN_LENGTH for each in tokens.values()
    ):
        raise ToolError(f"{path} has no tokens: delete it, and a new one is made")
    return tokens


class Access:
    """Decides which requests are answered, and which role their sender has.

    1. A page of another site cannot read or command anything: WebSockets need the origin of the
       page itself. If only this machine can connect, the `Host` header must name it, so that the
       name of another site does not lead here (DNS rebinding).
    2. If other machines can connect, every request needs a token: from a printed address, and
       then from the cookie that the page sets. Each role has its own token.

    Args:
        is_encrypted: True if the page is served over HTTPS.
        control: True if the role CONTROL exists. Otherwise its token gives the role LOOK.
        tokens: token of each role, used only if other machines can connect.

    Attributes:
        tokens: token of each role; empty if only this machine can connect.
        port: port that is listened on; set by the server once it listens, 0 before.
        scheme: `http` or `https`.
    """

    def __init__(
        self, host: str, *, is_encrypted: bool, control: bool, tokens: dict[Role, str]
    ) -> None:
        self._control = control
        self.tokens = {} if is_local(host) else tokens
        self.scheme = "https" if is_encrypted else "http"
        self.port = 0

    def refusal(self, request: web.BaseRequest) -> str:
        """Return the reason why a request is refused, and what to do; empty if it is answered."""
        hosts = request.headers.getall("Host", [])
        if len(hosts) != 1 or not _HOST.fullmatch(hosts[0]):
            return _NO_HOST()
        if not self.tokens and not _names_this_machine(hosts[0]):
            return _OTHER_HOST(url=f"{self.scheme}://127.0.0.1:{self.port}")
        if self.role(request) is None:
            return _NO_TOKEN()
        return ""

    def socket_refusal(self, request: web.BaseRequest) -> str:
        """Return the reason why a WebSocket is refused; empty if it is opened."""
        if reason := self.refusal(request):
            return reason
        if request.headers.getall("Origin", []) != [f"{self.scheme}://{request.headers['Host']}"]:
            return _OTHER_PAGE()
        return ""

    def role(self, request: web.BaseRequest) -> Role | None:
        """Return the role of the sender of a request; None if it needs a token and has none."""
        given = self._role_of(request.query.get("token", "")) or self._cookie_role(request)
        role = given if self.tokens else Role.CONTROL
        return role if self._control or role is None else Role.LOOK

    def set_cookie(self, request: web.BaseRequest, response: web.Response) -> None:
        """Set the cookie if the address of a request has a token.

        All pages in a browser share the cookie. A token for LOOK does not replace one for CONTROL,
        because an open page would lose its STOP button.
        """
        role = self._role_of(request.query.get("token", ""))
        if role is not None and self._cookie_role(request) is not Role.CONTROL:
            response.set_cookie(
                self._cookie_name,
                self.tokens[role],
                secure=self.scheme == "https",
                httponly=True,
                samesite="Strict",
            )

    def _cookie_role(self, request: web.BaseRequest) -> Role | None:
        try:
            return self._role_of(request.cookies.get(self._cookie_name, ""))
        except CookieError:  # another server on this host has set an invalid cookie
            return None

    @property
    def _cookie_name(self) -> str:
        return f"woosh_dashboard_{self.port}"  # browsers send cookies to all ports of a host

    def _role_of(self, token: str) -> Role | None:
        given = token.encode(errors="replace")
        for role, valid in self.tokens.items():
            if hmac.compare_digest(given, valid.encode()):
                return role
        return None


def _names_this_machine(host: str) -> bool:
    """Return True if a `Host` header names this machine."""
    try:
        name = urlsplit(f"//{host}").hostname
    except ValueError:
        return False
    return name is not None and is_local(name)


_MAX_OPENING = 64
"""Maximum number of connections that have not opened a WebSocket."""
_INPUT_RATE = 16 * 1024
"""Average rate at which bytes may arrive on a connection, in bytes per second."""
_INPUT_BURST = 64 * 1024
"""Number of bytes that may arrive on a connection at once."""

_MAX_WAITING = 4096
"""Number of bytes waiting to be sent on a WebSocket above which no further message is written.

It applies to the bytes that wait in this process, and separately to those in the system.
"""


class LimitedConnection(asyncio.Protocol):
    """A connection of a browser: passes everything on to aiohttp, with limits.

    1. Of the connections that are not WebSockets (yet), only the newest `_MAX_OPENING` are kept.
    2. A connection on which too many bytes arrive is cut: requests, messages and pings count.

    Args:
        inner: the protocol of aiohttp.
        opening: the connections of the server that are not WebSockets (yet), the oldest first, as
            an ordered set. Each connection adds and removes itself.

    Attributes:
        is_writable: set while few data wait to be sent.
    """

    def __init__(self, inner: asyncio.Protocol, opening: dict[LimitedConnection, None]) -> None:
        self._inner = inner
        self._opening = opening
        self._transport: asyncio.Transport
        """Set by `connection_made`."""
        self.is_writable = asyncio.Event()
        self.is_writable.set()
        self._allowance = float(_INPUT_BURST)
        """Number of bytes that may still arrive; it grows with time, up to `_INPUT_BURST`."""
        self._counted_at = -math.inf
        """Loop time at which `_allowance` was updated."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._opening[self] = None
        if len(self._opening) > _MAX_OPENING:
            oldest = next(iter(self._opening))
            del self._opening[oldest]
            oldest._transport.abort()
        self._inner.connection_made(transport)

    def opened(self) -> None:
        """Count as a WebSocket from now on, and let few data wait to be sent.

        A viewer with a slow connection gets fewer messages instead of outdated ones.
        """
        self._opening.pop(self, None)
        self._transport.set_write_buffer_limits(_MAX_WAITING)
        # with TLS, this limits only what is not encrypted yet; asyncio has no way to limit the rest
        if encryption := getattr(self._transport, "_ssl_protocol", None):
            encryption._transport.set_write_buffer_limits(_MAX_WAITING)
        system = self._transport.get_extra_info("socket")
        system.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _MAX_WAITING)

    def data_received(self, data: bytes) -> None:
        now = asyncio.get_running_loop().time()
        gained = (now - self._counted_at) * _INPUT_RATE
        self._allowance = min(_INPUT_BURST, self._allowance + gained) - len(data)
        self._counted_at = now
        if self._allowance < 0.0:
            self._transport.abort()
        else:
            self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def connection_lost(self, error: Exception | None) -> None:
        self._opening.pop(self, None)
        self._inner.connection_lost(error)

    def pause_writing(self) -> None:
        self.is_writable.clear()
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self.is_writable.set()
        self._inner.resume_writing()
