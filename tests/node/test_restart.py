"""An agent that is killed and started again: no command reaches the chassis twice."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

from tests.harness import TIMEOUT, Client, Program, wait_until
from tests.node.goals import EXEC_TASK, EXECUTING, SUCCEEDED, pause_task, short_task, task
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import Speak as SpeakMsg
from woosh_robot_msgs.msg import TaskProc as TaskProcMsg
from woosh_robot_msgs.srv import Speak

SPEAK = "woosh.robot.Speak"
TWIST = "woosh.robot.Twist"
COMMANDS = (SPEAK, EXEC_TASK, TWIST, "woosh.robot.ActionOrder", "woosh.ros.CallAction")


def speak_until_answered(client: Client, texts: Iterator[str]) -> str:
    """Call Speak with one text after the other until a call succeeds; return its text."""
    while True:
        text = next(texts)
        call = client.call_async(Speak, "robot/Speak", arg=SpeakMsg(text=text))
        answered = threading.Event()
        call.add_done_callback(lambda _future, answered=answered: answered.set())
        if answered.wait(1.0) and call.result().ok:
            return text


def command_counts(simulator: SimulatorThread) -> dict[str, int]:
    """Return how often the chassis has received each command."""
    counts = simulator.counts
    return {name: counts[name] for name in COMMANDS}


@pytest.mark.timeout(600)
def test_agent_killed_during_a_goal_repeats_no_command(
    program: Program,
    start_connected: Callable[[], Program],
    simulator: SimulatorThread,
    client: Client,
) -> None:
    texts = (f"text {number}" for number in itertools.count())
    speak_until_answered(client, texts)
    goal = task(client, mark="A23", task_id=77)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    pause_task(simulator)
    before = command_counts(simulator)
    program.process.kill()
    program.process.wait(TIMEOUT)
    wait_until(lambda: simulator.connections == 0)

    start_connected()
    assert command_counts(simulator) == before, "a new agent sends no command by itself"
    last = speak_until_answered(client, texts)
    procs = client.echo(TaskProcMsg, "robot/TaskProc")
    procs.wait(lambda proc: proc.robot_task_id == 77)
    assert simulator.counts[EXEC_TASK] == 1
    said = [each.message.text for each in simulator.received if each.type == SPEAK]
    assert len(said) == len(set(said))
    assert said[-1] == last
    assert simulator.call(lambda sim: sim.chassis.tasks.active), "the task is the robot's own"
    assert not goal.done, "no agent is left that could report its end"

    simulator.call(lambda sim: sim.chassis.tasks.cancel("enough"))
    # the first client still sees the action servers of the killed agent
    with closing(Client(program.domain)) as late:
        assert short_task(late, 0.3).result()[0] == SUCCEEDED
    assert simulator.counts[EXEC_TASK] == 2
