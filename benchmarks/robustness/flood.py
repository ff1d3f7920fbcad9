"""`scripts/bench --flood`: too many calls, pushes and bytes, and a chassis that answers slowly.

The agent runs in a process of its own, so that the memory of that process is the agent's alone. A
short flood of each kind comes first: after it every converter is compiled and DDS has its buffers.
The memory at that point is the idle memory that each flood is compared with.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import IO, Any

from benchmarks.figures import Figure, print_and_judge
from benchmarks.processes import MIB, start_module
from benchmarks.robustness.agent_process import DebugAgentProcess, connected_agent
from benchmarks.robustness.traffic import DuplicateAnswers
from tests.harness import Client
from tests.quick_chassis import quick_config
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import own_domain, wait_until
from woosh_robot_msgs.msg import PoseSpeed as PoseSpeedMsg
from woosh_robot_msgs.msg import StatusCode as StatusCodeMsg
from woosh_robot_msgs.srv import General, Twist

MAX_GROWTH = 1.2
"""Highest memory after a flood, as a multiple of the idle memory."""
SETTLE_TIME = 10.0
"""Maximum time until the memory is back within its limit after a flood, in seconds."""
TIMEOUT = 300.0
"""Time after which an answer or a push counts as lost, in seconds."""
SLOW_RATE = 200.0
"""Rate of the calls to a slow chassis, in Hz."""
_MAX_WARNINGS = 20
"""Highest number of warnings and errors in the log."""
_FIRST_MAP = 1_000_000
"""Map id of push number 0. It distinguishes the pushes of a flood from the simulator's own."""
_CALLS: tuple[tuple[Any, str], ...] = (
    (General, "robot/General"),
    (Twist, "robot/Twist"),
)
"""Services that the bystander calls, by ROS type and name."""


@dataclass(frozen=True)
class Size:
    """Size of the floods.

    Attributes:
        seconds: duration of each flood, in seconds.
        calls: rate of the calls, in Hz.
        pushes: rate of the pushes, in Hz.
        frame: size of the big frames, in MiB, below the agent's max_frame_size of 64 MiB.
        slow: time after which the slow chassis answers, in seconds.
        callers: number of calling processes. One Python process does not reach the default rate.
    """

    seconds: float = 10.0
    calls: float = 2000.0
    pushes: float = 5000.0
    frame: int = 60
    slow: float = 5.0
    callers: int = 2


WARM_UP = Size(seconds=0.5, frame=1, slow=0.2)


class Bench:
    """An agent that is flooded, its chassis, and a bystander: another client that calls the agent.

    Args:
        domain: ROS domain of the agent.
        simulator: the chassis.
        agent: the agent.
        callers: the programs that flood it with calls.

    Attributes:
        figures: results so far.
        idle: idle memory, in bytes; 0 as long as it is unknown.
    """

    def __init__(
        self,
        domain: int,
        simulator: SimulatorThread,
        agent: DebugAgentProcess,
        callers: Sequence[subprocess.Popen[str]],
    ) -> None:
        self.figures: list[Figure] = []
        self.idle = 0
        self._simulator = simulator
        self._agent = agent
        self._callers = callers
        self._client = Client(domain)
        self._bystander = _Bystander(self._client, simulator)
        self._poses = self._client.echo(PoseSpeedMsg, "robot/PoseSpeed")
        self._codes = self._client.echo(StatusCodeMsg, "robot/StatusCode", depth=5000)

    def close(self) -> None:
        self._client.close()

    # The floods

    def calls(self, size: Size) -> None:
        """Call faster than the agent can answer."""
        self._flood_with_calls("Calls", size.calls, size)

    def slow(self, size: Size) -> None:
        """Call while the chassis answers slowly."""
        slow = self._simulator.inject("delay", seconds=size.slow)
        self._flood_with_calls(
            f"Answers after {size.slow:g} s", SLOW_RATE, size, slow.clear, size.slow
        )

    def _flood_with_calls(
        self,
        part: str,
        rate: float,
        size: Size,
        finish: Callable[[], None] = lambda: None,
        slow: float = 0.0,
    ) -> None:
        before = self._counters()
        with self._agent.watch_rss() as samples:
            for caller in self._callers:
                _pipe(caller.stdin).write(f"{rate / len(self._callers)} {size.seconds}\n")
                _pipe(caller.stdin).flush()
            end = time.monotonic() + size.seconds
            self.figures += self._bystander.run(part, lambda: time.monotonic() > end)
            reports = [json.loads(_pipe(each.stdout).readline()) for each in self._callers]
        finish()
        sent = sum(report["sent"] for report in reports)
        answered = sum(report["answered"] for report in reports)
        reached = sum(report["sent"] / report["seconds"] for report in reports)
        missing = "".join(
            f"; caller {number} misses calls {report['missing']}"
            for number, report in enumerate(reports, 1)
            if report["missing"]
        )
        kinds: Counter[str] = Counter()
        for report in reports:
            kinds.update(report["kinds"])
        refused = _total(self._counters()["refused_requests"]) - _total(before["refused_requests"])
        self._add(part, f"calls, of {rate:.0f}/s wanted", f"{sent}, {reached:.0f}/s")
        self._add(
            part,
            "answered, each once",
            f"{answered} of {sent}{missing}",
            "all",
            answered == sent and not any(report["duplicates"] for report in reports),
        )
        self._add(
            part,
            "answers",
            ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())),
            "ok, or refused as too many",
            kinds.keys() <= {"ok", "too many"} and not (slow and not kinds["too many"]),
        )
        self._add(
            part,
            "refused, as counted",
            str(refused),
            "at least as many as the callers saw",
            refused >= kinds["too many"],
        )
        if slow:
            median = max(report["median"] for report in reports)
            self._add(
                part,
                "median response time, refused calls included",
                f"{median:.3f} s",
                "below that of the chassis",
                median < slow,
                depends_on_machine=True,
            )
        self._finish(part, samples)

    def pushes(self, size: Size) -> None:
        """Push states and status codes faster than ROS can publish. No status code may be lost."""
        part = "Pushes"
        before = self._counters()
        self._poses.messages.clear()
        self._codes.messages.clear()
        sent = {"poses": 0, "codes": 0}

        def push() -> None:
            begin = time.monotonic()
            while (elapsed := time.monotonic() - begin) < size.seconds:
                missing = int(elapsed * size.pushes) - sum(sent.values())
                if missing > 0:
                    self._simulator.call(lambda chassis, n=missing: _push_mixed(chassis, sent, n))
                time.sleep(0.005)
            self._simulator.call(lambda chassis: _push_mixed(chassis, sent, 10))

        with self._agent.watch_rss() as samples:
            begin = time.monotonic()
            self._run_beside_bystander(part, push)
            self._wait_pose(sent["poses"])
            self._codes.wait(lambda code: code.code == sent["codes"], TIMEOUT)
            duration = time.monotonic() - begin
        total = sum(sent.values())
        self._add(
            part,
            f"pushes, of {size.pushes:.0f}/s wanted",
            f"{total}, {total / size.seconds:.0f}/s; published in {duration:.1f} s",
        )
        self._add(part, "last push of each type published", "yes", "yes")
        numbers = [code.code for code in self._codes.messages]
        self._add(
            part,
            "status codes published in order",
            str(len(numbers)),
            "all that were published",
            numbers == sorted(numbers),
        )
        dropped = _total(self._counters()["dropped_pushes"]) - _total(before["dropped_pushes"])
        self._add(part, "pushes dropped, as counted", str(dropped))
        self._finish(part, samples)

    def frames(self, size: Size) -> None:
        """Send frames of almost the largest size that the agent accepts."""
        part = f"Frames of {size.frame} MiB"
        before = self._counters()
        frames = _big_frames(size.frame * MIB)
        self._poses.messages.clear()

        def send() -> None:
            for number, frame in enumerate(frames, 1):
                # one at a time, because two would exceed the simulator's outbox
                self._simulator.send_raw(frame)
                self._simulator.send_raw(_pose(number))
                self._wait_pose(number)

        with self._agent.watch_rss() as samples:
            begin = time.monotonic()
            self._run_beside_bystander(part, send)
            self._wait_pose(len(frames))
        duration = time.monotonic() - begin
        skipped = _total(self._counters()["bad_frames"]) - _total(before["bad_frames"])
        self._add(
            part,
            "frames read, or skipped and counted",
            f"{len(frames)} in {duration:.1f} s, {skipped} skipped",
        )
        self._finish(part, samples)

    def _run_beside_bystander(self, part: str, flood: Callable[[], None]) -> None:
        """Run `flood` in a thread, and the bystander until the flood ends."""
        flooding = threading.Thread(target=flood)
        flooding.start()
        self.figures += self._bystander.run(part, lambda: not flooding.is_alive())
        flooding.join()

    def _wait_pose(self, number: int) -> None:
        self._poses.wait(lambda message: message.map_id == _FIRST_MAP + number, TIMEOUT)

    # Results

    def _finish(self, part: str, samples: list[int]) -> None:
        connects = self._counters()["connects"]
        self._add(part, "times that the link was lost", str(connects - 1), "0", connects == 1)
        if not self.idle:
            return
        now = self._agent.settled_rss(MAX_GROWTH * self.idle, SETTLE_TIME)
        self._add(part, "highest memory during the flood", f"{max(samples) / MIB:.0f} MiB")
        self._add(
            part,
            "memory afterwards",
            f"{now / MIB:.0f} MiB, {now / self.idle:.2f} times idle",
            f"{MAX_GROWTH} times idle",
            now <= MAX_GROWTH * self.idle,
            depends_on_machine=True,
        )

    def _counters(self) -> dict[str, Any]:
        counters: dict[str, Any] = self._agent.debug()["counters"]
        return counters

    def _add(
        self,
        part: str,
        name: str,
        value: str,
        limit: str = "",
        ok: bool = True,
        *,
        depends_on_machine: bool = False,
    ) -> None:
        self.figures.append(Figure(part, name, value, limit, ok, depends_on_machine))


class _Bystander:
    """Another client of a flooded agent, whose calls must not be lost.

    Args:
        client: the ROS client that it uses.
        simulator: the chassis of the agent.
    """

    def __init__(self, client: Client, simulator: SimulatorThread) -> None:
        self._client = client
        self._simulator = simulator
        self._duplicates = DuplicateAnswers()
        for srv, name in _CALLS:
            self._duplicates.watch(client.service(srv, name))

    def run(self, part: str, until: Callable[[], bool]) -> list[Figure]:
        """Query and stop the robot every 0.1 s, and check that nothing is lost.

        Args:
            part: part of the benchmark to which the figures belong.
            until: ends the calls when it returns True.
        """
        asked: list[tuple[str, Any]] = []
        waits: dict[Any, float] = {}
        twists = self._simulator.counts["woosh.robot.Twist"]
        while not until():
            for srv, name in _CALLS:
                begin = time.monotonic()
                future = self._client.call_async(srv, name)
                future.add_done_callback(
                    lambda done, begin=begin: waits.setdefault(done, time.monotonic() - begin)
                )
                asked.append((name, future))
            threading.Event().wait(0.1)
        wait_until(
            lambda: len(waits) == len(asked),  # a future is done before its callbacks run
            f"answers to the bystander during {part}",
            TIMEOUT,
        )
        stops = [future.result() for name, future in asked if name == "robot/Twist"]
        received = self._simulator.counts["woosh.robot.Twist"] - twists
        return [
            Figure(
                part,
                "calls of a bystander answered, each once",
                f"{len(waits)} of {len(asked)}",
                "all",
                len(waits) == len(asked) and not self._duplicates.found,
            ),
            Figure(
                part,
                "its zero velocities that reached the chassis",
                f"{received} of {len(stops)}",
                "all",
                received == len(stops) and all(stop.ok for stop in stops),
            ),
            Figure(part, "longest wait of the bystander", f"{max(waits.values()):.2f} s"),
        ]


@contextlib.contextmanager
def _calling_programs(domain: int, count: int) -> Iterator[list[subprocess.Popen[str]]]:
    """Run the calling programs while the block runs."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with contextlib.ExitStack() as stack:
        callers = []
        for _ in range(count):
            caller = start_module("benchmarks.programs.flood_caller", domain=domain, **pipes)
            stack.callback(_kill, caller)
            callers.append(caller)
        for caller in callers:
            assert _pipe(caller.stdout).readline().strip() == "ready"
        yield callers


def _pipe(pipe: IO[str] | None) -> IO[str]:
    assert pipe is not None
    return pipe


def _kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    _pipe(process.stdin).close()
    _pipe(process.stdout).close()


def _push_mixed(chassis: Any, sent: dict[str, int], count: int) -> None:
    """Push states and status codes, four states for each code.

    Args:
        chassis: the simulator, in its own thread.
        sent: numbers of `poses` and `codes` pushed so far, updated by each push.
        count: number of further pushes.
    """
    for _ in range(count):
        kind = "codes" if sent["codes"] * 4 < sent["poses"] else "poses"
        sent[kind] += 1
        chassis.send_raw(_pose(sent[kind]) if kind == "poses" else _code(sent[kind]))


def _pose(number: int) -> str:
    """Return the push of a pose with this number."""
    return f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":{_FIRST_MAP + number}}}}}'


def _code(number: int) -> str:
    """Return the push of a status code with this number."""
    return f'{{"type":"woosh.robot.count.StatusCode","body":{{"code":"{number}"}}}}'


def _big_frames(size: int) -> list[str]:
    """Return large frames: two pushes without a subscription, and two with unknown fields."""
    text = "x" * size
    row = '{"id":1,"x":0.25,"y":-1.5,"name":"A1"}'
    rows = ",".join([row] * (size // (len(row) + 1)))
    return [
        f'{{"type":"woosh.map.SceneData","body":{{"name":"{text}"}}}}',
        f'{{"type":"woosh.map.SceneDataEasy","sn":2000000000,"ok":true,"body":{{"x":[{rows}]}}}}',
        f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":6,"extra":"{text}"}}}}',
        f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":6,"extra":[{rows}]}}}}',
    ]


def run(size: Size, *, measure_memory: bool = True) -> list[Figure]:
    """Run all floods on one agent, one after the other, and return the results.

    Args:
        size: size of the floods.
        measure_memory: compare the memory with that after a warm-up.
    """
    config = quick_config(port=0, tcp_port=0, seed=1, max_outbox=1_000_000)
    with (
        own_domain() as domain,
        SimulatorThread(config) as simulator,
        connected_agent(domain, simulator, poll_timeout=int(TIMEOUT * 1000)) as agent,
        _calling_programs(domain, size.callers) as callers,
        contextlib.closing(Bench(domain, simulator, agent, callers)) as bench,
    ):
        floods = (bench.calls, bench.pushes, bench.frames, bench.slow)
        if measure_memory:
            cold = agent.rss
            for flood in floods:
                flood(WARM_UP)
            bench.idle = agent.rss
            bench.figures = [
                Figure("Before", "memory when just connected", f"{cold / MIB:.0f} MiB"),
                Figure("Before", "idle memory, after a warm-up", f"{bench.idle / MIB:.0f} MiB"),
            ]
        for flood in floods:
            flood(size)
        return [*bench.figures, *_still_held(agent), *_logged(agent)]


def main(arguments: Sequence[str]) -> int:
    """Run all floods and print the table.

    Returns:
        The exit status: 1 if a limit was exceeded, otherwise 0.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench --flood",
        description="Floods the agent with calls, pushes and big frames, and prints the results. "
        "The exit status is 1 if a limit is exceeded.",
    )
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="duration of each flood (default 10)"
    )
    options = parser.parse_args(arguments)
    return print_and_judge(run(Size(seconds=options.seconds)))


def _still_held(agent: DebugAgentProcess) -> list[Figure]:
    """Wait until nothing of the floods is left in the agent; return the counts as figures."""
    names = ("requests", "pushes", "goals")
    deadline = time.monotonic() + TIMEOUT
    while any((held := agent.held())[name] for name in names) and time.monotonic() < deadline:
        threading.Event().wait(0.1)
    return [
        Figure("Held afterwards", name, str(held[name]), "0", held[name] == 0) for name in names
    ]


def _logged(agent: DebugAgentProcess) -> list[Figure]:
    """Check that the log shows the drops, and is not flooded itself."""
    agent.wait_logged("requests are in flight", TIMEOUT)
    warnings = [line for line in list(agent.lines) if "[WARN]" in line or "[ERROR]" in line]
    return [
        Figure(
            "Log",
            "warnings and errors",
            str(len(warnings)),
            str(_MAX_WARNINGS),
            len(warnings) <= _MAX_WARNINGS,
        )
    ]


def _total(counter: dict[str, int]) -> int:
    return sum(counter.values())
