"""The services: queries and commands of the table, answered when the chassis has answered."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.bridge import DeferredService, LinkThread, Reply
from woosh_robot_agent.convert import BadFieldError, Converter, converter, filled
from woosh_robot_agent.endpoints import COMMANDS, QUERIES, Command, Query
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import (
    Body,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    TooManyRequestsError,
)
from woosh_robot_agent.link.codecs.frames import FrameError
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.motion.gate import MotionGate
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.ros_types import class_of

_LOG = logging.getLogger(__name__)


class Services:
    """All services of the table.

    Args:
        node: owner of the services.
        thread: runs the link.
        chassis: to be used in the link's thread only.
        gate: passes commands on.
        known: answers queries while the chassis does not.
        requests: makes the chassis's messages of the callers'.

    Attributes:
        known: what the chassis last said.
    """

    def __init__(
        self,
        node: Any,
        thread: LinkThread,
        chassis: ChassisClient,
        gate: MotionGate,
        known: LastKnown,
        requests: RequestMaker,
    ) -> None:
        self.known = known
        self._servers: list[DeferredService] = []
        for query in QUERIES:
            handler = _QueryHandler(query, thread, chassis, known, requests)
            self._servers.append(DeferredService(node, handler.srv, query.name, handler.handle))
        for command in COMMANDS:
            server = _CommandHandler(command, thread, chassis, gate, requests)
            self._servers.append(DeferredService(node, server.srv, command.name, server.handle))


class _QueryHandler:
    """Asks the chassis; without an answer, gives the last known value, and logs why."""

    def __init__(
        self,
        endpoint: Query,
        thread: LinkThread,
        chassis: ChassisClient,
        known: LastKnown,
        requests: RequestMaker,
    ) -> None:
        self.srv = class_of(endpoint.srv, "srv")
        self._endpoint = endpoint
        self._thread = thread
        self._chassis = chassis
        self._known = known
        self._requests = requests
        self._log = LogOnce(_LOG)
        self._proto = message_type(endpoint.request)
        # the response's only field: info, nav_path or plan_path
        ((self._field, field_type),) = self.srv.Response.get_fields_and_field_types().items()
        self._convert = converter(class_of(field_type, "msg"), self._proto)
        self._takes_arg = "arg" in self.srv.Request.get_fields_and_field_types()

    def handle(self, request: Any, reply: Reply) -> None:
        self._thread.spawn(partial(self._answer, request, reply), reply.fail)

    async def _answer(self, request: Any, reply: Reply) -> None:
        name = self._endpoint.name
        try:
            value = await self._ask(request)
        except TooManyRequestsError as error:  # the link tells of it, once for all services
            _LOG.debug("%s answers with the last known value: %s", name, error)
            value = self._last_known()
        except (BadFieldError, LinkError, _RefusedError, _UselessAnswerError) as error:
            text = f"{name} answers with the last known value: {error}"
            self._log.warn(type(error).__name__, text)
            value = self._last_known()
        else:
            self._log.clear()
        reply.send(filled(self.srv.Response, **{self._field: value}))

    async def _ask(self, request: Any) -> Any:
        """The chassis's answer, as a ROS message."""
        answer = await self._chassis.request(self._message(request))
        if not answer.ok:
            raise _RefusedError(f"the chassis refused: {answer.msg}")
        if answer.type != self._endpoint.request:
            raise _UselessAnswerError(answer.defect or f"the chassis answered with {answer.type}")
        try:
            value = self._convert.read(answer.raw)
        except FrameError as error:
            raise _UselessAnswerError(f"the answer cannot be read: {error}") from None
        self._known.remember(answer.raw)
        return value

    def _last_known(self) -> Any:
        return self._convert.to_ros(self._known.get(self._endpoint.request) or self._proto())

    def _message(self, request: Any) -> Message:
        if not self._takes_arg:
            return self._requests.empty(self._proto)
        try:
            return self._requests.make(self._convert, request.arg)
        except BadFieldError as error:
            raise error.below("arg") from None


class _RefusedError(Exception):
    """The chassis did not answer a query, and said why."""


class _UselessAnswerError(Exception):
    """The chassis answered a query with something else."""


class _CommandHandler:
    """Passes a command to the chassis, and its answer back, untouched."""

    def __init__(
        self,
        endpoint: Command,
        thread: LinkThread,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
    ) -> None:
        self.srv = class_of(endpoint.srv, "srv")
        self._endpoint = endpoint
        self._thread = thread
        self._chassis = chassis
        self._gate = gate
        self._requests = requests
        arg_type = self.srv.Request.get_fields_and_field_types()["arg"]
        self._convert = converter(class_of(arg_type, "msg"), message_type(endpoint.request))
        self._convert_ret: Converter | None = None
        if endpoint.answer:
            ret_type = self.srv.Response.get_fields_and_field_types()["ret"]
            self._convert_ret = converter(class_of(ret_type, "msg"), message_type(endpoint.answer))

    def handle(self, request: Any, reply: Reply) -> None:
        try:
            message = self._requests.make(self._convert, request.arg)
        except BadFieldError as error:
            reply.send(self._response(False, f"{error.below('arg')}; nothing was sent"))
            return
        self._thread.spawn(partial(self._answer, message, reply), reply.fail)

    async def _answer(self, message: Message, reply: Reply) -> None:
        try:
            answer = await self._gate.request(message)
        except ConnectionLostError as error:
            reply.send(self._response(False, self._lost(error)))
            return
        except LinkError as error:
            reply.send(self._response(False, str(error)))
            return
        reply.send(self._response(answer.ok, answer.msg, answer.raw))

    def _lost(self, error: ConnectionLostError) -> str:
        return (
            f"lost the link to {self._chassis.config.address} before the chassis answered "
            f"{self._endpoint.request}: {error}; whether it took effect is not known"
        )

    def _response(self, ok: bool, msg: str, body: Body | None = None) -> Any:
        if self._convert_ret is None:
            return self.srv.Response(ok=ok, msg=msg)
        return filled(self.srv.Response, ok=ok, msg=msg, ret=self._ret(self._convert_ret, ok, body))

    def _ret(self, convert: Converter, ok: bool, body: Body | None) -> Any:
        """What the chassis gave back; blank where that is nothing, or something else."""
        if body is not None:
            try:
                if body.type == self._endpoint.answer:
                    return convert.read(body)
                body.message()  # of another type, which is no matter, or of an unknown one
            except FrameError as error:
                if ok:
                    text = "%s: accepted, but the answer cannot be read: %s"
                    _LOG.warning(text, self._endpoint.name, error)
        return convert.to_ros(convert.proto_class())
