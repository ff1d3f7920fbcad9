"""Pages and WebSockets at one port, with any supported release of `websockets`."""

from __future__ import annotations

import http
import inspect
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import SplitResult, parse_qs, urlsplit

from woosh_robot_agent.link.transport.websockets_compat import serve

_CLOSE_TIMEOUT = 1.0
"""Timeout of the closing handshake, in seconds."""
_OPEN_TIMEOUT = 5.0
"""Time in which a browser must have sent its request, in seconds."""
_PING_INTERVAL = 3.0
"""Time between two pings of a browser, in seconds."""
_PING_TIMEOUT = 10.0
"""Time without the answer to a ping after which the browser counts as gone, in seconds."""


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
    return await serve(
        handle,
        host,
        port,
        process_request=_process_request(respond),
        max_size=max_size,
        max_queue=16,
        compression=None,
        open_timeout=_OPEN_TIMEOUT,
        close_timeout=_CLOSE_TIMEOUT,
        ping_interval=_PING_INTERVAL,
        ping_timeout=_PING_TIMEOUT,
    )


def _process_request(respond: Respond) -> Callable[..., Any]:
    """Return the function that `websockets` calls with each request."""
    if "create_protocol" in inspect.signature(serve).parameters:  # before websockets 13

        async def process_legacy(path: str, headers: Any) -> Any:
            response = respond(_request(path, headers))
            if response is None:
                return None
            return response.status, response.all_headers, response.body

        return process_legacy

    from websockets.datastructures import Headers
    from websockets.http11 import Response as RawResponse

    async def process(_connection: Any, request: Any) -> Any:
        response = respond(_request(request.path, request.headers))
        if response is None:
            return None
        status = response.status
        headers = Headers(response.all_headers)
        return RawResponse(status.value, status.phrase, headers, response.body)

    return process


def _request(target: str, headers: Any) -> Request:
    values: dict[str, str | None] = {}
    for name, value in headers.raw_items():
        values[name.lower()] = None if name.lower() in values else value
    return Request(target, values)
