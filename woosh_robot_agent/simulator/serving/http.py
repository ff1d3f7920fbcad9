"""Requests over HTTP, on the port of the WebSocket: one request per call, without pushes.

POST /woosh/robot/PoseSpeed        the full name of the request's type, with slashes
{"robotId": 30001}                 its body as JSON; nothing for an empty one

200  {"type": "woosh.robot.PoseSpeed", "body": {...}, "ok": true, "msg": ""}
"""

from __future__ import annotations

import asyncio
from http import HTTPStatus
from typing import Any

from aiohttp import web
from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.frames import Envelope, FrameError, clip_type_name
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.link.server import HttpConnection, HttpServerTransport
from woosh_robot_agent.link.tasks import abort_transport, run_with_timeout
from woosh_robot_agent.link.transport import TransportClosedError
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.protocol.handlers import HANDLERS
from woosh_robot_agent.simulator.serving.exchange import Client, MessageHandler, Request

_BODY_TIMEOUT = 60.0
"""Timeout for the body of a request, in seconds."""

_ABOUT = """\
This is the simulated chassis of a Woosh robot, number {robot}.

It takes requests over WebSocket, or over HTTP: POST the body of a request as
JSON to the name of its type, with slashes instead of dots, for example

    curl -d '{{}}' http://{host}/woosh/robot/PoseSpeed
"""


class _HttpCodec(JsonCodec):
    """Codec of the envelope over HTTP, which has neither serial number nor timestamp."""

    def encode(
        self,
        type_name: str,
        body: Message | None,
        *,
        ok: bool | None = None,
        msg: str = "",
        **_left_out: int | None,
    ) -> str:
        return super().encode(type_name, body, ok=ok, msg=msg)


_CODEC = _HttpCodec(defaults=True)  # writes fields with default values too, as the chassis does


class HttpTransport(HttpServerTransport):
    """A `ServerTransport` for one HTTP call. Its only frame is the body of the response.

    Args:
        status: status of the response.

    Attributes:
        response: future of the response. If `send_raw` writes it, aiohttp gets an empty one, which
            goes nowhere.
    """

    def __init__(self, connection: HttpConnection, status: HTTPStatus) -> None:
        super().__init__(connection)
        self.response: asyncio.Future[web.Response] = asyncio.get_running_loop().create_future()
        self._status = status
        self._left = 0
        """Number of bytes of a raw response that have not been written; set by `header`."""

    async def send(self, data: str | bytes) -> None:
        body = data.encode() if isinstance(data, str) else data
        self._respond(web.Response(body=body, status=self._status, content_type="application/json"))

    def header(self, size: int, *, text: bool = False) -> bytes:
        head = (
            f"HTTP/1.1 {self._status.value} {self._status.phrase}\r\n"
            f"Content-Type: application/json\r\nContent-Length: {size}\r\nConnection: close\r\n\r\n"
        ).encode()
        self._left = len(head) + size
        return head

    async def send_raw(self, data: bytes) -> None:
        await super().send_raw(data)
        self._left -= len(data)
        if self._left <= 0:
            self._connection.transport.close()
            self._respond(web.Response())  # only ends the call: the connection is closed

    async def recv(self) -> str | bytes:
        raise TransportClosedError("a call has no further frames")

    async def close(self, timeout: float = 1.0) -> None:
        self.abort()

    def _respond(self, response: web.Response) -> None:
        if not self.response.done():  # a fault may send an answer twice
            self.response.set_result(response)


class HttpCalls:
    """Answers HTTP requests, by the same handlers as requests over a WebSocket.

    Args:
        reading: set while frames are read, i.e. unless the connections are paused.
        writing: set while frames are sent, i.e. neither paused nor frozen.
    """

    def __init__(
        self,
        handler: MessageHandler,
        config: SimulatorConfig,
        reading: asyncio.Event,
        writing: asyncio.Event,
    ) -> None:
        self._handler = handler
        self._config = config
        self._reading = reading
        self._writing = writing
        self._arriving = 0
        """Number of requests whose bodies are still arriving."""

    async def respond(
        self, request: web.BaseRequest, connection: HttpConnection
    ) -> web.StreamResponse:
        """Answer an HTTP request: execute a POST, and describe the server in answer to a GET."""
        await self._reading.wait()
        if request.method in ("GET", "HEAD"):
            about = _ABOUT.format(robot=self._config.robot_id, host=request.host)
            return web.Response(text=about)
        if request.method != "POST":
            return _refusal(HTTPStatus.METHOD_NOT_ALLOWED, "only POST and GET", Allow="GET, POST")
        if len(self._handler.clients) + self._arriving >= self._config.max_connections:
            text = f"there are already {self._config.max_connections} clients"
            return _refusal(HTTPStatus.SERVICE_UNAVAILABLE, text)
        if not self._handler.hooks.admit():
            abort_transport(connection.transport)
            return web.Response()  # goes nowhere: the connection is closed
        self._arriving += 1
        try:
            if request.headers.get("Expect", "").lower() == "100-continue":  # curl, large body
                await connection.write(b"HTTP/1.1 100 Continue\r\n\r\n")
            data = await run_with_timeout(_BODY_TIMEOUT, self._body(request))
        except TimeoutError as error:
            return _refusal(HTTPStatus.REQUEST_TIMEOUT, f"the body did not arrive: {error}")
        finally:
            self._arriving -= 1
        if data is None:
            text = f"the body has more than {self._config.max_frame} bytes"
            return _refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, text)
        await self._reading.wait()
        name = clip_type_name(request.path.strip("/").replace("/", "."))
        return await self._execute(connection, name, data)

    async def _body(self, request: web.BaseRequest) -> bytes | None:
        """Return the body of a request, or None if it is too large."""
        data = bytearray()
        async for chunk in request.content.iter_any():
            data += chunk
            if len(data) > self._config.max_frame:
                return None
        return bytes(data)

    async def _execute(
        self, connection: HttpConnection, name: str, data: bytes
    ) -> web.StreamResponse:
        """Execute the request of the type `name` with the body `data`, and return its response."""
        handler, status = self._handler, HTTPStatus.OK
        message, reason = None, ""
        if name not in HANDLERS:
            status, reason = HTTPStatus.NOT_FOUND, f"unknown message type {name}"
        else:
            try:
                body = _CODEC.parse(data) if data.strip() else {}
                message = _CODEC.body(Envelope(name, body), message_type(name))
            except FrameError as error:
                handler.bad_frames += 1
                status, reason = HTTPStatus.BAD_REQUEST, f"unreadable body: {error}"
        transport = HttpTransport(connection, status)
        client = Client(transport, self._config.max_outbox)
        handler.join(client)
        writing = asyncio.ensure_future(client.write(self._writing))
        ends: set[asyncio.Future[Any]] = {transport.response, connection.lost}
        try:
            handler.submit(Request(client, _CODEC, name, 0, message, reason))
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            handler.leave(client)
            writing.cancel()
        if not transport.response.done():  # the client has gone
            return web.Response()
        return transport.response.result()


def _refusal(status: HTTPStatus, text: str, **headers: str) -> web.Response:
    """Return the response to a request whose body is not read, and end the connection."""
    body = _CODEC.encode("error", None, ok=False, msg=text)
    response = web.Response(
        text=body, status=status, content_type="application/json", headers=headers
    )
    response.force_close()
    return response
