"""A chassis that sends exactly the frames that a test gives, over a real WebSocket.

The simulator decides by itself what it does; this chassis decides nothing. Frames are the literal
JSON of the wire, so no code of the agent takes part in making them.
"""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from tests.harness import wait_until
from woosh_robot_agent.link.server import (
    ConnectedClient,
    Listener,
    ServerTransport,
    serve_websocket,
)
from woosh_robot_agent.link.transport import TransportClosedError

T = TypeVar("T")
Body = dict[str, Any]

EXEC_TASK = "woosh.robot.ExecTask"
MODE = "woosh.robot.Mode"
ROBOT_INFO = "woosh.robot.RobotInfo"
ROBOT_STATE = "woosh.robot.RobotState"
TASK_HISTORY = "woosh.robot.TaskHistory"
TASK_PROC = "woosh.robot.TaskProc"
_ENDS = (7, 8, 9)
"""Task states kCompleted, kCanceled and kFailed."""
_TIMEOUT = 10.0


class ScriptedChassis:
    """A chassis in its own thread. Its methods can be called from the test's thread.

    It answers each query with the last value that it pushed, or with an empty one. It answers
    TaskHistory with the ends of tasks that it knows. Types in `refused` get a refusal. Requests for
    which `expect` has been called wait for `answer`, or run a script.

    Attributes:
        port: port of the WebSocket.
        requests: requests received, oldest first: their types and bodies.
    """

    def __init__(self) -> None:
        self.port = 0
        self.requests: list[tuple[str, Body]] = []
        self.refused: set[str] = set()
        self._values: dict[str, Body] = {}
        """The last value of each type."""
        self._ended: list[Body] = []
        """The last reports on ended tasks."""
        self._expected: dict[str, Callable[[], None]] = {}
        """What to do when a request comes, by its type."""
        self._waiting: list[tuple[ConnectedClient, str, int]] = []
        """Unanswered requests: their clients, types and serial numbers."""
        self._clients: list[ConnectedClient] = []
        self._listener: Listener | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="chassis", daemon=True)

    def __enter__(self) -> ScriptedChassis:
        self._thread.start()
        self.listen()
        return self

    def __exit__(self, *_: object) -> None:
        self.vanish()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_TIMEOUT)
        self._loop.close()

    # Frames

    def expect(self, request: str, script: Callable[[], None] | None = None) -> None:
        """Leave the answer to requests of a type to `answer`, and never answer earlier requests.

        Args:
            request: type of the request.
            script: called in the chassis's thread when a request comes; it may call all methods
                that send frames.
        """
        self._waiting.clear()
        self._expected[request] = script or (lambda: None)

    def answer(self, ok: bool = True, msg: str = "Request succeed") -> None:
        """Answer the oldest request that waits for its answer."""
        self._call(self._answer_oldest, ok, msg)

    def push(self, push: str, body: Body) -> None:
        """Push a value, and keep it for queries."""
        self._call(self._push, push, body)

    def push_all(self, push: str, bodies: Iterable[Body]) -> None:
        """Push values of one type, one after the other."""
        for body in bodies:
            self.push(push, body)

    def keep(self, push: str, body: Body) -> None:
        """Change a value without a push, as if the push had been lost."""
        self._call(self._keep, push, body)

    def forget_history(self) -> None:
        """Forget which tasks have ended."""
        self._call(self._ended.clear)

    def at_once(self, function: Callable[[], None]) -> None:
        """Call `function` in the chassis's thread, which receives nothing meanwhile."""
        self._call(function)

    # Requests

    def wait_request(self, request: str, count: int = 1) -> Body:
        """Wait for this many requests of a type; return the body of the last one."""

        def bodies() -> list[Body]:
            return [body for name, body in list(self.requests) if name == request]

        wait_until(lambda: len(bodies()) >= count, f"{count} requests {request}")
        return bodies()[-1]

    def count(self, request: str) -> int:
        """Return the number of requests of a type."""
        return sum(name == request for name, _ in list(self.requests))

    # Link

    @property
    def subscribed(self) -> set[str]:
        """Types of which a connected client gets the pushes."""
        return {topic for client in list(self._clients) for topic in list(client.topics)}

    def listen(self) -> None:
        """Accept connections, on the same port as before."""
        self._run(self._listen())

    def vanish(self) -> None:
        """Drop all connections and refuse new ones, once all frames so far have been sent."""
        self._run(self._vanish())

    async def _listen(self) -> None:
        self._listener = await serve_websocket(self._serve, "127.0.0.1", self.port, max_size=2**20)
        self.port = self._listener.port

    async def _vanish(self) -> None:
        listener, self._listener = self._listener, None
        for client in list(self._clients):
            while client.has_unsent:
                await asyncio.sleep(0.001)
            client.drop()
        self._waiting.clear()
        if listener is not None:
            await listener.close()

    async def _serve(self, transport: ServerTransport) -> None:
        client = ConnectedClient(transport, 10_000)
        self._clients.append(client)
        running = asyncio.Event()
        running.set()
        writer = asyncio.ensure_future(client.write(running))
        try:
            while True:
                self._receive(client, json.loads(await transport.recv()))
        except TransportClosedError:
            pass
        finally:
            self._clients.remove(client)
            writer.cancel()

    def _receive(self, client: ConnectedClient, frame: Body) -> None:
        name, body = frame["type"], frame["body"]
        if name == "woosh.Subscription":
            for topic in body["topics"]:
                client.topics[topic] = None  # type: ignore[assignment]
            return
        self.requests.append((name, body))
        if name in self.refused:
            self._answer(client, name, frame["sn"], {}, ok=False, msg="not supported")
        elif name in self._expected:
            self._waiting.append((client, name, frame["sn"]))
            self._expected[name]()
        else:
            self._answer(client, name, frame["sn"], self._value(name))

    def _value(self, name: str) -> Body:
        if name == ROBOT_INFO:
            state = self._values.get(ROBOT_STATE, {}).get("state", 2)
            return {"robotId": 10001, "state": state, "mode": {"ctrl": 1, "work": 2}}
        if name == TASK_HISTORY:
            return {"tes": self._ended}
        return self._values.get(name, {})

    def _answer(
        self,
        client: ConnectedClient,
        name: str,
        sn: int,
        body: Body,
        ok: bool = True,
        msg: str = "Request succeed",
    ) -> None:
        frame = {"type": name, "body": body, "ok": ok, "msg": msg, "sn": sn}
        client.send(json.dumps(frame, ensure_ascii=False))

    def _answer_oldest(self, ok: bool, msg: str) -> None:
        client, name, sn = self._waiting.pop(0)
        self._answer(client, name, sn, {}, ok, msg)

    def _keep(self, push: str, body: Body) -> None:
        self._values[push] = body
        if push == TASK_PROC and body.get("state") in _ENDS:
            self._ended.append(body)

    def _push(self, push: str, body: Body) -> None:
        self._keep(push, body)
        for client in self._clients:
            if push in client.topics:
                client.send(json.dumps({"type": push, "body": body}, ensure_ascii=False))

    # Threads

    def _call(self, function: Callable[..., None], *args: Any) -> None:
        if threading.current_thread() is self._thread:
            function(*args)
            return

        async def call() -> None:
            function(*args)

        self._run(call())

    def _run(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(_TIMEOUT)
