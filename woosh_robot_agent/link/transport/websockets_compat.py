"""Differences between the releases of `websockets`, from 10.4 (Ubuntu 24.04) to today's."""

from __future__ import annotations

import inspect
from typing import Any

from websockets.exceptions import InvalidHandshake

__all__ = ["RAW_TEXT", "ClientSocket", "Connect", "serve"]

ClientSocket: Any
_connect: Any
serve: Any
try:  # websockets 13 and later
    from websockets.asyncio.client import ClientConnection as ClientSocket
    from websockets.asyncio.client import connect as _connect
    from websockets.asyncio.server import serve

    _FACTORY_OPTION = "create_connection"
except ImportError:
    from websockets.legacy.client import WebSocketClientProtocol as ClientSocket
    from websockets.legacy.client import connect as _connect
    from websockets.legacy.server import serve

    _FACTORY_OPTION = "create_protocol"

RAW_TEXT: dict[str, Any] = (
    {"decode": False} if "decode" in inspect.signature(ClientSocket.recv).parameters else {}
)
"""Options of `recv` with which text frames come as bytes. Otherwise a text frame that is not UTF-8
ends the connection."""
_NO_PROXY: dict[str, Any] = (
    {"proxy": None} if "proxy" in inspect.signature(_connect).parameters else {}
)


class Connect(_connect):
    """`websockets.connect` that follows no redirects and uses no proxy.

    Args:
        factory: makes the client's socket object.
    """

    def __init__(self, uri: str, *, factory: Any, **options: Any) -> None:
        super().__init__(uri, **{_FACTORY_OPTION: factory}, **_NO_PROXY, **options)

    def process_redirect(self, exc: Exception) -> Exception:
        """Refuse a redirect; called by websockets 14 and later."""
        return exc

    def handle_redirect(self, uri: str) -> None:
        """Refuse a redirect; called by websockets before 14."""
        raise InvalidHandshake(f"it redirects to {uri}")
