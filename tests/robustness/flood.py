"""`scripts/bench --flood`: clients and a chassis that send too much, and one that answers slowly.

The agent is a process of its own, so that what is measured is its memory alone: the resident set
as /proc has it. Two figures stand before the floods: `cold`, right after connecting, and `idle`,
which is what the floods are judged by, after a short one of each kind, for by then every converter
is compiled and DDS has its buffers. After each flood the memory must be back within 1.2 times
idle, for which it gets `SETTLE` s.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from subprocess import PIPE
from typing import Any

from benchmarks.process import MIB, AgentProcess, connected_agent, module, rss
from benchmarks.table import Figure, markdown
from tests.harness import Client, own_domain, wait_until
from tests.robustness.traffic import Surplus
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_msgs.msg import PoseSpeed as PoseSpeedMsg
from woosh_robot_msgs.msg import StatusCode as StatusCodeMsg
from woosh_robot_msgs.srv import General, Twist

MOST_GROWTH = 1.2
"""Times the idle memory that the agent may hold once a flood is over."""
SETTLE = 10.0
"""s after a flood in which the memory must be back."""
PATIENCE = 60.0
"""s that what was asked during a flood gets to be answered, on a machine that is too slow."""
CALLERS = 2
"""Processes that call: one in Python does not reach the rate."""
_FIRST_MAP = 1_000_000


@dataclass(frozen=True)
class Size:
    """How much of a flood.

    Attributes:
        seconds: how long it lasts.
        calls: calls per s.
        pushes: pushes per s.
        frame: size of the big frames in MiB, which stays below the agent's max_frame_size of 64.
        slow: s after which the slow chassis answers.
    """

    seconds: float = 10.0
    calls: float = 2000.0
    pushes: float = 5000.0
    frame: int = 60
    slow: float = 5.0


WARM_UP = Size(seconds=0.5, frame=1, slow=0.2)


class Bench:
    """The agent in a process of its own, a chassis, and a bystander who wants to be served.

    Attributes:
        figures: what was found so far.
    """

    def __init__(self, domain: int, simulator: SimulatorThread, agent: AgentProcess) -> None:
        self.simulator = simulator
        self.agent = agent
        self.figures: list[Figure] = []
        self.idle = 0
        self._domain = domain
        self._client = Client(domain)
        self._surplus = Surplus()
        self._services = [(General, "robot/General", {}), (Twist, "robot/Twist", {})]
        for srv, name, _ in self._services:
            self._surplus.watch(self._client.service(srv, name))
        self.poses = self._client.echo(PoseSpeedMsg, "robot/PoseSpeed")
        self.codes = self._client.echo(StatusCodeMsg, "robot/StatusCode", depth=5000)

    def close(self) -> None:
        self._client.close()

    @contextlib.contextmanager
    def callers(self, rate: float, seconds: float, service: str) -> Iterator[list[Any]]:
        """Programs that call; gives the list of their reports, filled at the end of the block."""
        arguments = (str(rate / CALLERS), str(seconds), service)
        with contextlib.ExitStack() as stack:
            callers = []
            for _ in range(CALLERS):
                options = {"stdin": PIPE, "stdout": PIPE}
                caller = module("benchmarks.caller", *arguments, domain=self._domain, **options)
                stack.callback(_end, caller)
                callers.append(caller)
            for caller in callers:
                assert caller.stdout.readline().strip() == "ready"
            for caller in callers:
                caller.stdin.write("go\n")
                caller.stdin.flush()
            reports: list[Any] = []
            yield reports
            reports += [json.loads(caller.stdout.readline()) for caller in callers]

    def bystander(self, part: str, until: Callable[[], bool]) -> None:
        """Ask and stop the robot every 0.1 s as long as the flood lasts: nothing may get lost."""
        asked: list[tuple[str, float, Any]] = []
        waits: dict[Any, float] = {}
        twists = self.simulator.counts["woosh.robot.Twist"]
        while not until():
            for srv, name, fields in self._services:
                begun = time.monotonic()
                future = self._client.call_async(srv, name, **fields)
                future.add_done_callback(
                    lambda done, begun=begun: waits.setdefault(done, time.monotonic() - begun)
                )
                asked.append((name, begun, future))
            threading.Event().wait(0.1)
        wait_until(
            lambda: all(future.done() for *_, future in asked),
            f"answers to the bystander during {part}",
            PATIENCE,
        )
        stops = [future.result() for name, _, future in asked if name == "robot/Twist"]
        through = self.simulator.counts["woosh.robot.Twist"] - twists
        self._found(
            part,
            "calls of a bystander answered, each once",
            f"{len(waits)} of {len(asked)}",
            "all",
            len(waits) == len(asked) and not self._surplus.found,
        )
        self._found(
            part,
            "his zero velocities that reached the chassis",
            f"{through} of {len(stops)}",
            "all",
            through == len(stops) and all(stop.ok for stop in stops),
        )
        self._found(part, "longest wait of the bystander", f"{max(waits.values()):.2f} s")

    def memory(self, part: str, most: int) -> None:
        """Judge the memory after a flood."""
        now = self.agent.settled_rss(MOST_GROWTH * self.idle, SETTLE)
        self._found(part, "largest memory meanwhile", f"{most / MIB:.0f} MiB")
        self._found(
            part,
            "memory afterwards",
            f"{now / MIB:.0f} MiB, {now / self.idle:.2f} times idle",
            f"{MOST_GROWTH} times idle",
            now <= MOST_GROWTH * self.idle,
        )

    def still_connected(self, part: str) -> None:
        connects = self.agent.look()["stats"]["connects"]
        self._found(part, "times that the link was lost", str(connects - 1), "0", connects == 1)

    def _found(self, part: str, name: str, value: str, limit: str = "", kept: bool = True) -> None:
        self.figures.append(Figure(part, name, value, limit, kept))

    @contextlib.contextmanager
    def watched(self) -> Iterator[list[int]]:
        """Sample the memory during the block."""
        samples = [rss(self.agent.process.pid)]
        stop = threading.Event()

        def watch() -> None:
            while not stop.wait(0.1):
                samples.append(rss(self.agent.process.pid))

        watching = threading.Thread(target=watch)
        watching.start()
        try:
            yield samples
        finally:
            stop.set()
            watching.join()

    # The floods

    def calls(self, size: Size) -> None:
        """Clients call faster than the agent can take it."""
        part = "Calls"
        before = self.agent.look()["stats"]
        with self.watched() as samples, self.callers(size.calls, size.seconds, "Speak") as reports:
            end = time.monotonic() + size.seconds
            self.bystander(part, lambda: time.monotonic() > end)
        sent = sum(report["sent"] for report in reports)
        answered = sum(report["answered"] for report in reports)
        kinds = _added(report["kinds"] for report in reports)
        rate = sum(report["sent"] / report["seconds"] for report in reports)
        once = answered == sent and not any(report["twice"] for report in reports)
        known = kinds.keys() <= {"ok", "too many"}
        self._found(part, f"calls, of {size.calls:.0f}/s wanted", f"{sent}, {rate:.0f}/s")
        self._found(part, "answered, each once", f"{answered} of {sent}", "all", once)
        told = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
        self._found(part, "answers", told, "done, or refused as too many", known)
        refused = _grown(before, self.agent.look()["stats"], "refused_requests")
        self._found(
            part,
            "refused, as counted",
            str(refused),
            "as many as were told so",
            refused >= kinds.get("too many", 0),
        )
        self._finish(part, samples)

    def pushes(self, size: Size) -> None:
        """The chassis pushes faster than ROS can take it: states, and codes that each count."""
        part = "Pushes"
        before = self.agent.look()["stats"]
        self.poses.messages.clear()
        self.codes.messages.clear()
        sent = {"poses": 0, "codes": 0}
        over = threading.Event()

        def push() -> None:
            begun = time.monotonic()
            while (passed := time.monotonic() - begun) < size.seconds:
                behind = int(passed * size.pushes) - sum(sent.values())
                if behind > 0:
                    self.simulator.call(lambda chassis, count=behind: _push(chassis, sent, count))
                time.sleep(0.005)
            self.simulator.call(lambda chassis: _push(chassis, sent, 10))
            over.set()

        with self.watched() as samples:
            pushing = threading.Thread(target=push)
            begun = time.monotonic()
            pushing.start()
            self.bystander(part, over.is_set)
            pushing.join()
            rate = sum(sent.values()) / size.seconds
            self._wait_pose(sent["poses"])
            self.codes.wait(lambda code: code.code == sent["codes"], PATIENCE)
            taken = time.monotonic() - begun
        self._found(
            part,
            f"pushes, of {size.pushes:.0f}/s wanted",
            f"{sum(sent.values())}, {rate:.0f}/s; taken in {taken:.1f} s",
        )
        self._found(part, "last of each kind published", "yes", "yes")
        dropped = _grown(before, self.agent.look()["stats"], "dropped_pushes")
        numbers = [code.code for code in self.codes.messages]
        self._found(
            part,
            "codes published in their order",
            str(len(numbers)),
            "all that were",
            numbers == sorted(numbers),
        )
        self._found(part, "dropped, as counted", str(dropped))
        self._finish(part, samples)

    def frames(self, size: Size) -> None:
        """The chassis sends frames as large as the agent takes them."""
        part = f"Frames of {size.frame} MiB"
        before = self.agent.look()["stats"]
        frames = _big_frames(size.frame * MIB)
        self.poses.messages.clear()
        over = threading.Event()

        def send() -> None:
            try:
                for number, frame in enumerate(frames, 1):  # more than one at a time do not fit
                    self.simulator.send_raw(frame)
                    self.simulator.send_raw(_pose(number))
                    self._wait_pose(number)
            finally:
                over.set()

        with self.watched() as samples:
            sending = threading.Thread(target=send)
            begun = time.monotonic()
            sending.start()
            self.bystander(part, over.is_set)
            sending.join()
            self._wait_pose(len(frames))
        seconds = time.monotonic() - begun
        bad = _grown(before, self.agent.look()["stats"], "bad_frames")
        self._found(
            part,
            "frames read, or skipped and counted",
            f"{len(frames)} in {seconds:.1f} s, {bad} skipped",
        )
        self._finish(part, samples)

    def slow(self, size: Size) -> None:
        """The chassis takes its time over each answer, and callers do not."""
        part = f"Answers after {size.slow:g} s"
        before = self.agent.look()["stats"]
        slow = self.simulator.inject("delay", seconds=size.slow)
        with self.watched() as samples, self.callers(200, size.seconds, "Speak") as reports:
            end = time.monotonic() + size.seconds
            self.bystander(part, lambda: time.monotonic() > end)
        slow.clear()
        sent = sum(report["sent"] for report in reports)
        answered = sum(report["answered"] for report in reports)
        kinds = _added(report["kinds"] for report in reports)
        refused = _grown(before, self.agent.look()["stats"], "refused_requests")
        self._found(part, "calls", f"{sent}, 200/s wanted")
        self._found(
            part,
            "answered, each once",
            f"{answered} of {sent}",
            "all",
            answered == sent and not any(report["twice"] for report in reports),
        )
        told = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
        self._found(
            part,
            "answers",
            told,
            "done, or refused as too many",
            kinds.keys() <= {"ok", "too many"} and kinds.get("too many", 0) > 0,
        )
        median = max(report["median"] for report in reports)
        self._found(
            part,
            "median wait of the callers, most of them refused",
            f"{median:.3f} s",
            "below the chassis's",
            median < size.slow,
        )
        self._found(
            part,
            "refused, as counted",
            str(refused),
            "as many as were told so",
            refused >= kinds.get("too many", 0),
        )
        self._finish(part, samples)

    def _wait_pose(self, number: int) -> None:
        self.poses.wait(lambda pose: pose.map_id == _FIRST_MAP + number, PATIENCE)

    def _finish(self, part: str, samples: list[int]) -> None:
        self.still_connected(part)
        if self.idle:
            self.memory(part, max(samples))


def run(size: Size) -> list[Figure]:
    """All floods, one after the other, on one agent; what was found."""
    config = SimulatorConfig(port=0, tcp_port=0, seed=1, max_outbox=1_000_000)
    with (
        own_domain() as domain,
        SimulatorThread(config) as simulator,
        connected_agent(domain, simulator, poll_timeout=int(PATIENCE * 1000)) as agent,
    ):
        bench = Bench(domain, simulator, agent)
        with contextlib.closing(bench):
            floods = (bench.calls, bench.pushes, bench.frames, bench.slow)
            cold = agent.sample().rss
            for flood in floods:
                flood(WARM_UP)
            bench.figures.clear()
            bench.idle = agent.sample().rss
            bench.figures += [
                Figure("Before", "memory when just connected", f"{cold / MIB:.0f} MiB"),
                Figure("Before", "idle: after a warm-up", f"{bench.idle / MIB:.0f} MiB"),
            ]
            for flood in floods:
                flood(size)
            bench.figures += _logged(agent)
            return bench.figures


def main(arguments: Sequence[str]) -> int:
    """Run all floods and print the table.

    Returns:
        0, or 1 where a limit was exceeded.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench --flood",
        description="Floods the agent from both sides and prints what became of it. The exit "
        "status is 1 if a limit was exceeded.",
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="of each flood; default 10")
    options = parser.parse_args(arguments)
    figures = run(Size(seconds=options.seconds))
    print(markdown(figures))
    exceeded = [figure for figure in figures if not figure.kept]
    for figure in exceeded:
        print(f"exceeded: {figure.part}: {figure.name}: {figure.value}", file=sys.stderr)
    return 1 if exceeded else 0


def _logged(agent: AgentProcess) -> list[Figure]:
    """The log says that things are dropped, and when it is over how many: nothing else, no more."""
    agent.wait_says("requests were refused because too many were in flight")
    lines = [line for line in agent.lines if "[WARN]" in line or "[ERROR]" in line]
    most = 20
    return [
        Figure("Log", "warnings and errors", str(len(lines)), f"{most}", len(lines) <= most),
        *(
            Figure("Log", "said", line.split("]: ", 1)[-1].strip())
            for line in agent.lines
            if "that is over" in line
        ),
    ]


def _push(chassis: Any, sent: dict[str, int], count: int) -> None:
    for _ in range(count):
        kind = "codes" if sent["codes"] * 4 < sent["poses"] else "poses"
        sent[kind] += 1
        chassis.send_raw(_pose(sent[kind]) if kind == "poses" else _code(sent[kind]))


def _pose(number: int) -> str:
    return f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":{_FIRST_MAP + number}}}}}'


def _code(number: int) -> str:
    return f'{{"type":"woosh.robot.count.StatusCode","body":{{"code":"{number}"}}}}'


def _big_frames(size: int) -> list[str]:
    """Pushes that nobody wants, pushes with much that nobody knows, and a late answer."""
    text = "x" * size
    row = '{"id":1,"x":0.25,"y":-1.5,"name":"A1"}'
    rows = ",".join([row] * (size // (len(row) + 1)))
    return [
        f'{{"type":"woosh.map.SceneData","body":{{"name":"{text}"}}}}',
        f'{{"type":"woosh.map.SceneDataEasy","sn":2000000000,"ok":true,"body":{{"x":[{rows}]}}}}',
        f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":6,"extra":"{text}"}}}}',
        f'{{"type":"woosh.robot.PoseSpeed","body":{{"mapId":6,"extra":[{rows}]}}}}',
    ]


def _added(counts: Any) -> dict[str, int]:
    total: dict[str, int] = {}
    for each in counts:
        for kind, count in each.items():
            total[kind] = total.get(kind, 0) + count
    return total


def _grown(before: dict[str, Any], now: dict[str, Any], name: str) -> int:
    return sum(now[name].values()) - sum(before[name].values())


def _end(process: Any) -> None:
    process.kill()
    process.wait()
    process.stdin.close()
    process.stdout.close()
