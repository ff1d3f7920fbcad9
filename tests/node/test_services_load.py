"""Concurrent calls: no call waits for another, and each gets exactly one answer."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import pytest

from tests.harness import Client, wait_future, wait_until
from woosh_robot_agent.parameters import EXECUTORS
from woosh_robot_agent.ros.bridge import Reply
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.srv import General, Mode, SetSound, Speak, SwitchControlMode

SPEAK = "woosh.robot.Speak"


@pytest.fixture(params=EXECUTORS)
def busy_agent(request: Any, simulator: Any, start_agent: Any) -> Any:
    agent = start_agent(ip="127.0.0.1", port=simulator.port, executor=request.param)
    agent.wait_connected()
    return agent


def speak(client: Any, text: str) -> Any:
    return client.call_async(Speak, "robot/Speak", arg=SpeakMsg(text=text))


def test_a_slow_call_holds_up_no_other(simulator, busy_agent, client):
    simulator.mute(SPEAK)
    slow = speak(client, "slow")
    simulator.wait_received(SPEAK)
    assert client.call(SwitchControlMode, "robot/SwitchControlMode") is not None
    assert client.call(Mode, "robot/Mode").info.ctrl.value == 1
    simulator.accept(SPEAK)
    assert wait_future(speak(client, "quick")).ok  # even a call of the same service
    assert not slow.done()
    simulator.drop()
    assert not wait_future(slow).ok


def test_calls_wait_for_their_answers_concurrently(simulator, busy_agent, client):
    simulator.mute(SPEAK)
    calls = [speak(client, str(number)) for number in range(40)]
    simulator.wait_received(SPEAK, 40)
    assert not any(call.done() for call in calls)
    simulator.drop()
    for call in calls:
        assert "lost the link" in wait_future(call).msg


def test_answers_in_another_order_find_their_callers(simulator, busy_agent, client):
    held: list[Any] = []

    def hold(frame: Any) -> list[Any]:
        if frame.request != SPEAK:
            return [frame]
        held.append(frame)
        return held[::-1] if len(held) == 5 else []

    simulator.intercept(hold)
    simulator.refuse(SPEAK, "")
    calls = []
    for number in range(5):
        calls.append(speak(client, str(number)))
        simulator.wait_received(SPEAK, number + 1)
    assert not any(wait_future(call).ok for call in calls)
    assert len({frame.sn for frame in held}) == 5


def test_a_flood_is_answered_to_the_last_call(simulator, busy_agent, client):
    simulator.mute(SPEAK)
    calls = [speak(client, str(number)) for number in range(200)]
    wait_until(
        lambda: sum(call.done() for call in calls) == 200 - 64, "refusal of what exceeds the limit"
    )
    for call in (call for call in calls if call.done()):
        assert "64 requests are in flight" in call.result().msg
    simulator.wait_received(SPEAK, 64)
    simulator.accept(SPEAK)
    simulator.drop()
    for call in calls:
        assert not wait_future(call).ok
    busy_agent.wait_connected(2)
    assert wait_future(speak(client, "again")).ok


def test_too_many_queries_are_logged_once(simulator, busy_agent, client, logs):
    simulator.mute(SPEAK)
    for number in range(64):
        speak(client, str(number))
    simulator.wait_received(SPEAK, 64)
    for _ in range(3):
        assert client.call(Mode, "robot/Mode").info.ctrl.value == 1  # the last known value
        assert client.call(General, "robot/General").info.serial_number == 30001
    simulator.drop()
    busy_agent.wait_connected(2)
    told = [record for record in logs.messages if "requests are in flight" in record.getMessage()]
    warnings = [record for record in told if record.levelname == "WARNING"]
    assert len(told) > len(warnings) == 1


def test_a_vanished_client_causes_no_error(simulator, busy_agent, client, domain, logs):
    simulator.mute(SPEAK)
    gone = Client(domain)
    speak(gone, "left")
    simulator.wait_received(SPEAK)
    gone.close()
    simulator.drop()
    busy_agent.wait_connected(2)
    simulator.accept(SPEAK)
    assert wait_future(speak(client, "stayed")).ok
    assert not [record for record in logs.messages if record.levelname == "ERROR"]


def test_each_call_gets_one_answer(simulator, busy_agent, client):
    """Answers are counted in the client, because rclpy drops a second answer silently."""
    numbers: Counter[int] = Counter()
    service = client.service(Speak, "robot/Speak")
    expect = service.get_pending_request

    def count(number: int) -> Any:
        numbers[number] += 1
        return expect(number)

    service.get_pending_request = count
    for number in range(20):
        assert wait_future(speak(client, str(number))).ok
    assert len(numbers) == 20
    assert set(numbers.values()) == {1}


def test_text_that_ros_cannot_encode_does_not_lose_the_answer(simulator, busy_agent, client):
    """A JSON string may contain a lone surrogate, which has no UTF-8 encoding."""

    def garble(frame: Any) -> list[Any]:
        if frame.request != SPEAK:
            return [frame]
        answer = {"type": SPEAK, "sn": frame.sn, "ok": True, "msg": "a\ud800b", "body": {}}
        simulator._simulator.send_raw(json.dumps(answer))
        return []

    simulator.intercept(garble)
    response = wait_future(speak(client, "x"))
    assert response.ok
    assert (response.msg[0], response.msg[-1]) == ("a", "b")
    assert client.call(General, "robot/General").info.serial_number == 30001


def test_an_exception_in_a_callback_is_answered(simulator, busy_agent, client, logs):
    service = busy_agent.agent._services
    broken = next(s for s in service._servers if s._service.srv_name.endswith("setting/Sound"))
    broken._handle = lambda request, reply: 1 / 0
    response = client.call(SetSound, "setting/Sound")
    assert not response.ok
    assert "ZeroDivisionError" in response.msg
    assert client.call(Mode, "robot/Mode").info.ctrl.value == 1
    assert [record.levelname for record in logs.messages if record.exc_info] == ["ERROR"]


class TestReply:
    """A reply is sent exactly once."""

    @pytest.fixture
    def sent(self) -> list[Any]:
        return []

    @pytest.fixture
    def reply(self, sent: list[Any]) -> Reply:
        def send(response: Any, header: Any) -> None:
            sent.append((response.msg, header))

        return Reply(Speak.Response, send, "header")

    def test_a_second_response_is_not_sent(self, reply, sent, logs):
        reply.send(Speak.Response(msg="a"))
        reply.fail(RuntimeError("b"))
        assert sent == [("a", "header")]
        assert [record.levelname for record in logs.messages] == ["ERROR"]

    @pytest.mark.parametrize("error", [OverflowError, TypeError, SystemError])
    def test_an_error_while_sending_is_answered(self, error, logs):
        sent: list[Any] = []

        def send(response: Any, header: Any) -> None:
            if response.ok:
                raise error("too large")
            sent.append((response.msg, header))

        Reply(Speak.Response, send, "header").send(Speak.Response(ok=True))
        assert [(error.__name__ in text, header) for text, header in sent] == [(True, "header")]

    def test_a_response_that_cannot_be_encoded_is_replaced(self, logs):
        sent: list[Any] = []

        def send(response: Any, header: Any) -> None:
            response.msg.encode()
            sent.append((response.ok, header))

        reply = Reply(Speak.Response, send, "header")
        reply.send(Speak.Response(ok=True, msg="\ud800"))
        assert sent == [(False, "header")]
