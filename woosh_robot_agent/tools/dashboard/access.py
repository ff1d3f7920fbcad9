"""Rules for who may open the page, and what the page may do in the browser."""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
from http.cookies import CookieError, SimpleCookie
from types import MappingProxyType
from urllib.parse import urlsplit

from woosh_robot_agent.tools.dashboard.http import Request

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
