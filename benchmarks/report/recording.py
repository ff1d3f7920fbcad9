"""Cost of `record` at 1000 frames a second, compared with a bare proxy.

The chassis pushes PoseSpeed as JSON. The recording is read with the MCAP libraries alone, and must
have every frame. The exit status is 1 if a limit is exceeded.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from benchmarks.processes import Program, running
from benchmarks.programs.start import echo_chassis
from benchmarks.report.machine import describe_machine
from benchmarks.report.pages import DOCS, write_part
from benchmarks.report.table import markdown
from woosh_robot_agent.link.transport.websockets_compat import ClientSocket, Connect
from woosh_robot_agent.testing import own_domain, wait_until

FLOOR = "bare proxy"
"""Title of the floor's row."""
PROXY = "`record --listen`"
"""Title of the row of a recording between a client and the robot."""
ALONE = "`record`"
"""Title of the row of a recording with a connection of its own to the robot."""
_RATE = 1000
"""Frames per second."""
_FIRST = 1_000_000
"""Number of the first frame that is measured; those of the warm-up have smaller ones."""
_MAX_CPU = 15.0
"""Maximum CPU time of `record`, in percent of a core."""
_TOPIC = "/chassis/robot/PoseSpeed"
_RECORD = "woosh_robot_agent.tools.record"
_SUBSCRIPTION = {"sub": True, "topics": ["woosh.robot.PoseSpeed"]}


@contextmanager
def _subscribed_client(port: int) -> Iterator[None]:
    """Run a client that discards all pushes; the block starts when it has subscribed."""
    loop = asyncio.new_event_loop()
    ready = threading.Event()

    async def discard() -> None:
        url = f"ws://127.0.0.1:{port}"
        async with Connect(url, factory=ClientSocket, compression=None, max_size=None) as socket:
            for sn, (name, body) in enumerate(
                [("woosh.Subscription", _SUBSCRIPTION), ("woosh.robot.RobotInfo", {})]
            ):
                await socket.send(json.dumps({"type": name, "body": body, "sn": sn}))
            while True:
                await socket.recv()  # the first one is the answer, and so follows the subscription
                ready.set()

    task = loop.create_task(discard())
    thread = threading.Thread(target=lambda: loop.run_until_complete(asyncio.wait({task})))
    thread.start()
    try:
        wait_until(ready.is_set, "the answer to the client")
        yield
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join()
        loop.close()


def _push(chassis: Program, first: int, count: int) -> None:
    chassis.send("push", _RATE, first, count)
    chassis.receive()


def _measure(program: Program, chassis: Program, count: int) -> dict[str, float]:
    """Return the CPU time of a program while frames pass, in percent of a core."""
    cpu = program.cpu
    _push(chassis, _FIRST, count)
    return {"cpu": 100.0 * (program.cpu - cpu) / (count / _RATE)}


def _has_pushes(path: Path) -> bool:
    """Return True if a file that is being written contains pushes."""
    try:
        with path.open("rb") as file:
            return any(
                getattr(record, "topic", "") == _TOPIC for record in StreamReader(file).records
            )
    except (EndOfFile, FileNotFoundError):
        return False


def _finish(record: Program, path: Path, count: int) -> dict[str, float]:
    """End a recording; return the number of lost frames and the size of one in the file."""
    record.interrupt()
    if status := record.process.wait():
        raise RuntimeError(f"record ended with status {status}. Its log:\n{record.log}")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [message.mileage for *_, message in reader.iter_decoded_messages([_TOPIC])]
    lost = len(set(range(_FIRST, _FIRST + count)).difference(found))
    return {"lost": lost, "size": path.stat().st_size / len(found)}


def measure(seconds: float) -> dict[str, dict[str, float]]:
    """Return the figures of the floor and of both kinds of recordings."""
    count = int(_RATE * seconds)
    found = {}
    with (
        own_domain() as domain,
        tempfile.TemporaryDirectory() as folder,
        echo_chassis(domain, "websocket") as (chassis, port),
    ):
        with (
            running("benchmarks.floors.proxy", str(port), domain=domain) as proxy,
            _subscribed_client(proxy.receive()),
        ):
            _push(chassis, 0, _RATE)
            found[FLOOR] = _measure(proxy, chassis, count)
        path = Path(folder, "proxy.mcap")
        robot = ("--ip", "127.0.0.1", "--port", str(port), "--output")
        with running(
            _RECORD, *robot, str(path), "--listen", "127.0.0.1:0", domain=domain
        ) as record:
            assert record.process.stdout is not None
            listening = record.process.stdout.readline()
            record.check_running()
            with _subscribed_client(int(listening.split("127.0.0.1:")[-1].split(",")[0])):
                _push(chassis, 0, _RATE)
                found[PROXY] = _measure(record, chassis, count)
            found[PROXY] |= _finish(record, path, count)
        path = Path(folder, "alone.mcap")
        with running(_RECORD, *robot, str(path), domain=domain) as record:
            while not _has_pushes(path):
                record.check_running()
                _push(chassis, 0, _RATE)
            found[ALONE] = _measure(record, chassis, count)
            found[ALONE] |= _finish(record, path, count)
    return found


def excess(found: dict[str, dict[str, float]]) -> list[str]:
    """Return the limits that are exceeded."""
    problems = []
    for name in (PROXY, ALONE):
        figures = found[name]
        if figures["cpu"] > _MAX_CPU:
            problems.append(
                f"CPU of {name}: {figures['cpu']:.1f} % of a core, limit {_MAX_CPU:g} %"
            )
        if figures["lost"]:
            problems.append(f"frames that {name} lost: {figures['lost']:.0f}")
    return problems


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench --recording",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, not a table")
    parser.add_argument(
        "--smoke", action="store_true", help="measure for seconds, only to see that it works"
    )
    parser.add_argument(
        "--docs", action="store_true", help="write the results to docs/recordings.md"
    )
    given = parser.parse_args(arguments)
    if given.docs and given.smoke:
        parser.error("--docs cannot be combined with --smoke, whose figures mean nothing")
    found = measure(1.0 if given.smoke else 20.0)
    floor = found[FLOOR]["cpu"]
    rows = [
        (
            name,
            f"{figures['cpu']:.1f} %",
            f"{figures['cpu'] / floor:.1f}",
            *(
                (f"{figures['lost']:.0f}", f"{figures['size']:.0f}")
                if "lost" in figures
                else ("", "")
            ),
        )
        for name, figures in found.items()
    ]
    header = ("", "CPU of a core", "relative to bare proxy", "frames lost", "bytes per frame")
    table = markdown(header, rows, "lrrrr")
    print(json.dumps(found) if given.json else table)
    if given.docs:
        text = f"{describe_machine()}.\n\n{table}"
        write_part("recording", text, DOCS / "recordings.md")
    problems = [] if given.smoke else excess(found)
    for problem in problems:
        print(f"exceeded: {problem}", file=sys.stderr)
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
