"""The services in `endpoints.QUERIES` and `endpoints.COMMANDS`, forwarded to the chassis."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import BadFieldError, Converter, converter, new_message
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import COMMANDS, QUERIES, Command, Query
from woosh_robot_agent.link import (
    Answer,
    Body,
    ConnectionLostError,
    FrameError,
    LinkError,
    TooManyRequestsError,
)
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.tasks import LARGE, offload, start_task
from woosh_robot_agent.motion import Sender, Silence, UnusableVelocityError, VelocityLimits
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.motion.timeliness import SenderClock
from woosh_robot_agent.motion.velocity_driver import NOT_PERMITTED
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.robot.readiness import EMERGENCY_STOP
from woosh_robot_agent.robot.watch import Watch
from woosh_robot_agent.ros.bridge import DeferredService, Reply
from woosh_robot_agent.ros.context import RobotContext
from woosh_robot_agent.sentences import NOT_SENT

_LOG = logging.getLogger(__name__)
_LIMITED = "the velocity was limited by cmd_vel_max_linear or cmd_vel_max_angular"
_LARGE_VALUE = LARGE // 8
"""Size from which a protobuf message counts as large, in bytes: its JSON can be eight times as
long."""


def create_services(
    robot: RobotContext, watch: Watch, limits: Callable[[], VelocityLimits]
) -> None:
    """Create the services; the node owns them.

    Args:
        watch: gets each call that commands a velocity, and tells when velocities are refused.
        limits: returns the limits of velocities.
    """
    for query in QUERIES:
        _QueryHandler(query, robot)
    for command in COMMANDS:
        if command.request == full_name(Twist):
            _VelocityHandler(command, robot, watch, limits)
        else:
            _CommandHandler(command, robot)


class _QueryHandler:
    """Handler of a service that reads a value of the chassis.

    If the chassis gives no usable answer, the response holds the last known value, or is blank if
    there is none. The log says why.
    """

    def __init__(self, endpoint: Query, robot: RobotContext) -> None:
        self._srv = class_of(endpoint.srv, "srv")
        self._endpoint = endpoint
        self._robot = robot
        self._log = LogOnce(_LOG)
        self._proto = message_type(endpoint.request)
        field_type = self._srv.Response.get_fields_and_field_types()[endpoint.field]
        self._convert = converter(class_of(field_type, "msg"), self._proto)
        self._converting: tuple[Message, asyncio.Task[Any]] | None = None
        """A large last known value that is being converted, and the task that converts it."""
        DeferredService(robot.node, self._srv, endpoint.name, self._handle)

    def _handle(self, request: Any, reply: Reply) -> None:
        self._robot.thread.spawn(partial(self._answer, request, reply), reply.fail)

    async def _answer(self, request: Any, reply: Reply) -> None:
        try:
            value, is_large = await self._request_value(request)
        except TooManyRequestsError as error:  # the link warns of it, once for all services
            _LOG.debug("%s: %s", self._fallback_text, error)
            value, is_large = await self._last_value()
        except (BadFieldError, LinkError, _RefusedError, _UnusableAnswerError) as error:
            self._log.warn(type(error).__name__, f"{self._fallback_text}: {error}")
            value, is_large = await self._last_value()
        else:
            self._log.clear()
        response = new_message(self._srv.Response, **{self._endpoint.field: value})
        await _send(reply, response, is_large=is_large)

    async def _request_value(self, request: Any) -> tuple[Any, bool]:
        """Request the value from the chassis; return it, and True if sending it may take long.

        Raises:
            BadFieldError: the request cannot be converted.
            LinkError: as in `ChassisClient.request`.
            _RefusedError: the chassis refused the request.
            _UnusableAnswerError: the answer holds no value that can be read.
        """
        # with an argument, the answer may be about another task, or another robot of a gateway
        tap = self._remember if request == self._srv.Request() else None
        answer = await self._robot.chassis.request(self._chassis_request(request), tap=tap)
        if not answer.ok:
            raise _RefusedError(f"the chassis refused: {answer.reason}")
        if answer.type != self._endpoint.request:
            raise _UnusableAnswerError(answer.defect or f"the chassis answered with {answer.type}")
        try:
            value = await _read(self._convert, answer.raw)
        except FrameError as error:
            raise _UnusableAnswerError(f"the answer cannot be read: {error}") from None
        return value, answer.raw.is_large

    def _remember(self, answer: Answer) -> None:
        """Keep an answer as the last known value.

        Called in order with the pushes, so that the answer replaces no newer value.
        """
        is_usable = answer.ok and answer.type == self._endpoint.request
        if is_usable and not answer.is_outdated:
            last_known = self._robot.last_known
            # read the previous value first: it stays if this one turns out to be unreadable
            last_known.get(answer.type)
            last_known.remember(answer.raw)

    @property
    def _fallback_text(self) -> str:
        """Log text that says what the service responds without a usable answer of the chassis."""
        name = self._endpoint.name
        if self._robot.last_known.get(self._endpoint.request) is None:
            return f"{name} answers blank, because no value is known yet"
        return f"{name} answers with the last known value"

    async def _last_value(self) -> tuple[Any, bool]:
        """Return the last known value, or a blank one, and True if sending it may take long."""
        last = self._robot.last_known.get(self._endpoint.request) or self._proto()
        if last.ByteSize() < _LARGE_VALUE:
            return self._convert.to_ros(last), False
        if self._converting is None or self._converting[0] is not last:
            # all calls that come while it is converted share the result
            task = start_task(
                offload(self._convert.to_ros, last), name=f"convert {self._endpoint.name}"
            )
            self._converting = (last, task)
            task.add_done_callback(self._conversion_ended)
        return await asyncio.shield(self._converting[1]), True

    def _conversion_ended(self, task: asyncio.Task[Any]) -> None:
        if self._converting is not None and self._converting[1] is task:
            self._converting = None

    def _chassis_request(self, request: Any) -> Message:
        """Return the request to the chassis for a request of a client.

        Raises:
            BadFieldError: a value must not be sent to the robot.
        """
        if not self._endpoint.takes_arg:
            return self._robot.requests.empty(self._proto)
        try:
            return self._robot.requests.make(self._convert, request.arg)
        except BadFieldError as error:
            raise error.below("arg") from None


class _RefusedError(Exception):
    """The chassis refused a query; the text has its reason."""


class _UnusableAnswerError(Exception):
    """The answer to a query cannot be read, or has another type."""


class _CommandHandler:
    """Handler of a service that sends a command: forwards its request, and the answer."""

    def __init__(self, endpoint: Command, robot: RobotContext, *, urgent: bool = False) -> None:
        self._srv = class_of(endpoint.srv, "srv")
        self._endpoint = endpoint
        self._robot = robot
        arg_type = self._srv.Request.get_fields_and_field_types()["arg"]
        self._convert = converter(class_of(arg_type, "msg"), message_type(endpoint.request))
        self._convert_ret: Converter | None = None
        """Converter of the field `ret` in the response; None if the response has none."""
        if endpoint.answer:
            ret_type = self._srv.Response.get_fields_and_field_types()["ret"]
            self._convert_ret = converter(class_of(ret_type, "msg"), message_type(endpoint.answer))
        self._clock = SenderClock()
        """Estimates when a client sent its call, because late commands are refused."""
        DeferredService(robot.node, self._srv, endpoint.name, self._handle, urgent=urgent)

    def _handle(self, request: Any, reply: Reply) -> None:
        try:
            message = self._robot.requests.make(self._convert, request.arg)
        except BadFieldError as error:
            self._refuse_arg(reply, error)
            return
        published = self._clock.published(*reply.times, time.monotonic())
        self._robot.thread.spawn(partial(self._answer, message, reply, published), reply.fail)

    def _refuse_arg(self, reply: Reply, error: Exception) -> None:
        """Send the response to a call whose `arg` cannot be sent; `error` names the field."""
        reply.send(self._response(False, f"arg.{error}; nothing was sent"))

    async def _answer(
        self, message: Message, reply: Reply, published: float, note: str = ""
    ) -> None:
        """Send a command, and the client's response; a success has `note` added to its text."""
        address = self._robot.chassis.config.address  # parameters may change it meanwhile
        try:
            answer = await self._robot.gate.request(
                message, sender=Sender(self._endpoint.name, published)
            )
        except ConnectionLostError as error:
            text = (
                f"lost the link to {address} before the chassis answered "
                f"{self._endpoint.request}: {error}; whether it took effect is not known"
            )
            reply.send(self._response(False, text))
            return
        except LinkError as error:
            reply.send(self._response(False, str(error)))
            return
        response = await self._response_for(answer)
        if note and answer.ok:
            response.msg = f"{response.msg}; {note}" if response.msg else note
        await _send(reply, response, is_large=answer.raw.is_large)

    async def _response_for(self, answer: Answer) -> Any:
        """Return the response for an answer of the chassis.

        If the chassis accepted the command, but its answer has no readable `ret`, a command that
        reads a value has failed. Any other command has been executed, so it still succeeds.
        """
        if self._convert_ret is None:
            return self._response(answer.ok, answer.msg)
        ret, defect = await self._read_ret(self._convert_ret, answer.raw)
        if defect and answer.ok:
            if self._endpoint.reads:
                return self._response(False, f"no usable answer: {defect}")
            if answer.defect:  # empty if the chassis just echoes the request, which is normal
                _LOG.warning("%s: accepted, but %s", self._endpoint.name, answer.defect)
        return self._response(answer.ok, answer.msg, ret)

    async def _read_ret(self, convert: Converter, body: Body) -> tuple[Any, str]:
        """Return the field `ret` from an answer and "", or None and why it cannot be read."""
        endpoint = self._endpoint
        # some firmware labels the answer with the type of the request
        if endpoint.two_types and body.type == endpoint.request:
            body = body.as_type(endpoint.answer)
        if body.type != endpoint.answer:
            return None, f"the chassis answered with {body.type}, not with {endpoint.answer}"
        try:
            return await _read(convert, body), ""
        except FrameError as error:
            return None, f"the answer cannot be read: {error}"

    def _response(self, ok: bool, msg: str, ret: Any = None) -> Any:
        """Return a response; its field `ret`, if it has one, is blank by default."""
        if self._convert_ret is None:
            return self._srv.Response(ok=ok, msg=msg)
        if ret is None:
            ret = self._convert_ret.to_ros(self._convert_ret.proto_class())
        return new_message(self._srv.Response, ok=ok, msg=msg, ret=ret)


class _VelocityHandler(_CommandHandler):
    """Handler of robot/Twist, whose velocities obey `limits`.

    After a stop or an interruption, they are refused until a client sends a zero, or none calls for
    a while: a program that simply repeats its calls must not move the robot again.
    """

    def __init__(
        self,
        endpoint: Command,
        robot: RobotContext,
        watch: Watch,
        limits: Callable[[], VelocityLimits],
    ) -> None:
        super().__init__(endpoint, robot, urgent=True)
        self._watch = watch
        self._limits = limits
        self._silence = Silence(robot.gate)
        watch.interruptions.on_begin(self._silence.begin)

    async def _answer(self, message: Any, reply: Reply, published: float, note: str = "") -> None:
        moves = may_move(message)
        self._silence.note_received(moves, published)
        if moves:
            self._watch.velocities.note_call(self._endpoint.name, reply.sequence_number)
            # a zero or a pause ends a refusal, but not while the button is pressed
            if self._watch.interruptions.is_pressed:
                self._silence.begin(str(EMERGENCY_STOP))
            if self._robot.chassis.refusal(message):  # the gate refuses it, and tells why
                self._silence.begin(NOT_PERMITTED)
            elif self._silence.reason:
                reply.send(self._response(False, NOT_SENT(reason=self._silence.objection)))
                return
        try:
            limited = self._limits().apply(message)
        except UnusableVelocityError as error:
            self._refuse_arg(reply, error)
            return
        await super()._answer(limited, reply, published, "" if limited == message else _LIMITED)


async def _send(reply: Reply, response: Any, *, is_large: bool) -> None:
    """Send a response; a large one in the thread for large messages, so the link goes on."""
    if is_large:
        await offload(reply.send, response)
    else:
        reply.send(response)


async def _read(convert: Converter, body: Body) -> Any:
    """Return a body as a ROS message; convert a large one in the thread for large messages.

    Raises:
        FrameError: the body cannot be read.
    """
    return await offload(convert.read, body) if body.is_large else convert.read(body)
