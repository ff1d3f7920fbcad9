"""A bare WebSocket client: it writes prepared frames to a socket, without a library.

A floor uses it where its rclpy thread sends: the library that the link uses sends only from an
asyncio event loop, and the hand-over to its thread would be part of the floor.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from urllib.parse import urlsplit

_HANDSHAKE = (
    "GET / HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
_TEXT = 0x81
"""First byte of a text frame that is not continued."""
_MASKED = 0x80
_TWO_BYTES, _EIGHT_BYTES = 126, 127
"""Length in the second byte of a frame that says that the length follows in more bytes."""


class BareSocket:
    """A connection to a chassis.

    Args:
        url: address of the chassis.
        receive: called with each frame of the chassis, in a thread of its own.
    """

    def __init__(self, url: str, receive: Callable[[bytes], object]) -> None:
        host, _, port = urlsplit(url).netloc.partition(":")
        self._socket = socket.create_connection((host, int(port)))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.sendall(_HANDSHAKE.format(host=host).encode())
        self._stream = self._socket.makefile("rb")
        while self._stream.readline() not in (b"\r\n", b""):
            pass
        threading.Thread(target=self._read, args=(receive,), daemon=True).start()

    def send(self, text: str) -> None:
        """Write one frame. Its masking key is zero, so the text needs no masking."""
        payload = text.encode()
        size = len(payload)
        if size < _TWO_BYTES:
            head = bytes((_TEXT, _MASKED | size))
        else:
            head = bytes((_TEXT, _MASKED | _TWO_BYTES)) + size.to_bytes(2, "big")
        self._socket.sendall(head + bytes(4) + payload)

    def _read(self, receive: Callable[[bytes], object]) -> None:
        while head := self._stream.read(2):
            size = head[1]
            if size in (_TWO_BYTES, _EIGHT_BYTES):
                size = int.from_bytes(self._stream.read(2 if size == _TWO_BYTES else 8), "big")
            receive(self._stream.read(size))
