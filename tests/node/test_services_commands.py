"""Command services: requests to the chassis, and responses to clients."""

from __future__ import annotations

import ctypes
import itertools
import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from rclpy.task import Future

from tests.convert.random_messages import blank, carried, item_type, random_proto, random_ros
from tests.convert.type_pairs import field_class
from tests.harness import wait_future, wait_until
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import COMMANDS
from woosh_robot_agent.link.protos import message_type
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.srv import Mode, SetSound, Speak, SwitchControlMode

SPEAK = "woosh.robot.Speak"


def srv_of(command: Any) -> Any:
    return class_of(command.srv, "srv")


def arg_class(command: Any) -> Any:
    return field_class(srv_of(command).Request, "arg")


def test_request_and_answer_pass_untouched(simulator, agent, client):
    rng = random.Random(7)
    for number, command in enumerate(COMMANDS):
        ok = number % 2 == 0
        arg = random_ros(rng, arg_class(command))
        if command.name == "robot/Twist":  # beyond the limits, it would be changed or refused
            arg = type(arg)(linear=0.25, angular=-0.5)
        msg = "请求失败: \n\u00e9 🤖" + command.name
        changes = {"ok": ok, "msg": msg, "type": command.answer or command.request, "body": None}
        if command.answer:
            ret_class = field_class(srv_of(command).Response, "ret")
            proto_class = message_type(command.answer)
            changes["body"] = random_proto(rng, proto_class, ret_class)
        simulator.refuse(command.request, "not done")
        undo = simulator.intercept(
            lambda f, changes=changes: [replace(f, **changes) if f.request else f]
        )
        response = client.call(srv_of(command), command.name, arg=arg)
        undo()
        sent = simulator.last(command.request)
        assert sent == converter(type(arg), type(sent)).to_proto(carried(arg)), command.name
        assert (response.ok, response.msg) == (ok, msg)
        if command.answer:
            ret = converter(ret_class, proto_class).to_ros(changes["body"])
            assert response.ret == ret, command.name


def test_ok_and_msg_are_used_even_with_a_body_of_another_type(simulator, agent, client):
    for kind in ("woosh.robot.Battery", "woosh.robot.Unheard", "error"):
        changes = {"ok": True, "msg": "done", "type": kind, "body": None}
        undo = simulator.intercept(
            lambda f, changes=changes: [replace(f, **changes) if f.request else f]
        )
        response = client.call(SwitchControlMode, "robot/SwitchControlMode")
        assert (response.ok, response.msg) == (True, "done")
        assert response.ret == blank(response.ret)
        assert client.call(Speak, "robot/Speak").ok
        undo()


def test_call_without_a_link_fails_with_the_reason(start_agent, client):
    agent = start_agent(ip="127.0.0.1", port=1, poll_timeout=60_000)
    wait_until(lambda: agent.agent.robot.chassis.last_error, "the first attempt")
    for command in COMMANDS[::10]:
        response = client.call(srv_of(command), command.name)
        assert not response.ok
        assert "not connected to ws://127.0.0.1:1 since 2" in response.msg, command.name
        assert "Connection refused" in response.msg


def test_call_without_an_answer_fails_after_the_timeout(simulator, connect, client):
    connect(poll_timeout=500)
    quick = [command for command in COMMANDS if not command.timeout][::10]
    for command in quick:
        simulator.mute(command.request)
    calls = {c: client.call_async(srv_of(c), c.name) for c in quick}
    for command, call in calls.items():
        response = wait_future(call)
        assert not response.ok
        assert f"did not answer {command.request} within 0.5 s" in response.msg


def test_call_fails_if_the_link_is_lost_and_is_not_repeated(simulator, agent, client):
    simulator.mute(SPEAK)
    call = client.call_async(Speak, "robot/Speak")
    simulator.wait_received(SPEAK)
    simulator.drop()
    response = wait_future(call)
    assert not response.ok
    assert f"lost the link to ws://127.0.0.1:{simulator.port}" in response.msg
    assert SPEAK in response.msg
    agent.wait_connected(2)
    simulator.accept(SPEAK)
    assert client.call(Speak, "robot/Speak", arg=SpeakMsg(text="new")).ok
    assert [r.message.text for r in simulator.received if r.type == SPEAK] == ["", "new"]


# Values that must not reach the robot


def leaves(cls: Any, kinds: tuple[str, ...], path: str = "") -> Iterator[str]:
    """Yield the paths of all nested fields of these types; a list stands for its first item."""
    for name, kind in cls.get_fields_and_field_types().items():
        of = item_type(kind)
        where = f"{path}{name}" + ("[0]" if of else "")
        if (of or kind) in kinds:
            yield where
        elif "/" in kind:
            yield from leaves(class_of(of or kind, "msg"), kinds, where + ".")


def message_with(cls: Any, path: str, value: Any) -> Any:
    """Return a message with `value` at `path`."""
    message = cls()
    step, _, rest = path.partition(".")
    name = step.removesuffix("[0]")
    kind = cls.get_fields_and_field_types()[name]
    if rest:
        value = message_with(class_of(item_type(kind) or kind, "msg"), rest, value)
    setattr(message, name, [value] if item_type(kind) else value)
    if hasattr(message, "which"):  # of a oneof, only the member that is set is sent
        (member,) = (each for each in dir(cls) if each.endswith(f"_{name.upper()}_SET"))
        message.which = getattr(cls, member)
    return message


def test_bad_values_are_named_and_not_sent(simulator, agent, client):
    values = itertools.cycle([math.nan, -math.inf])
    for command in COMMANDS:
        for path in leaves(arg_class(command), ("float",)):
            arg = message_with(arg_class(command), path, next(values))
            response = client.call(srv_of(command), command.name, arg=arg)
            assert not response.ok
            assert response.msg.startswith(f"arg.{path}"), command.name
        assert not simulator.counts[command.request]


def test_the_replacement_character_is_text_like_any_other(simulator, agent, client):
    """rclpy also puts it in place of bytes that are not UTF-8, which are refused."""
    assert client.call(Speak, "robot/Speak", arg=SpeakMsg(text="a\ufffd谢b")).ok
    assert simulator.last(SPEAK).text == "a\ufffd谢b"


class CString(ctypes.Structure):
    """The C type rosidl_runtime_c__String. A Speak request consists of one."""

    _fields_ = [
        ("data", ctypes.c_char_p),
        ("size", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
    ]


def speak_bytes(client: Any, text: bytes) -> Any:
    """Send bytes that need not be UTF-8, as a C client can. rclpy would check the text."""
    service = client.service(Speak, "robot/Speak")
    request, number = CString(text, len(text), len(text) + 1), ctypes.c_int64()
    send = ctypes.CDLL("librcl.so").rcl_send_request
    with service.handle, service._lock:  # the executor must not read the answer yet
        where = ctypes.c_void_p(service.handle.pointer)
        assert send(where, ctypes.byref(request), ctypes.byref(number)) == 0
        future = service._pending_requests[number.value] = Future()
    return wait_future(future)


def test_bytes_that_are_not_utf_8_become_replacement_characters(simulator, agent, client):
    assert speak_bytes(client, b"ab\xff\xc3ef").ok
    assert simulator.last(SPEAK).text == "ab\ufffd\ufffdef"


# The robot id, and old clients


def test_configured_robot_id_is_sent_unless_the_client_sets_one(simulator, connect, client):
    connect(robot_id=4_000_000_000)
    own = SetSound.Request().arg
    own.request.which = own.request.REQUEST_ROBOT_ID_SET
    for arg, robot_id in ((SetSound.Request().arg, 4_000_000_000), (own, 0)):
        client.call(SetSound, "setting/Sound", arg=arg)
        sent = simulator.last("woosh.robot.setting.Sound")
        assert (sent.WhichOneof("request"), sent.robot_id) == ("robot_id", robot_id)
    client.call(Mode, "robot/Mode")
    assert simulator.last("woosh.robot.Mode").robot_id == 4_000_000_000


def test_no_robot_id_is_sent_by_default(simulator, agent, client):
    client.call(SetSound, "setting/Sound")
    assert simulator.last("woosh.robot.setting.Sound").WhichOneof("request") is None
