"""Cost of `record` at 1000 frames a second, compared with a bare proxy and a bare client.

Each second the chassis pushes 890 PoseSpeed, 100 status codes and 10 scans with 1080 beams, as
JSON. The CPU time is that of the measured program only. The recordings are read with the MCAP
libraries alone, and must have every frame. The exit status is 1 if a limit is exceeded, or if this
machine was too busy for 1000 frames a second.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from benchmarks.figures import markdown
from benchmarks.options import make_parser, report
from benchmarks.processes import Program, running, running_chassis
from woosh_robot_agent.testing import own_domain

PROXY_FLOOR = "bare proxy"
"""Title of the row of the floor of `record --listen`."""
CLIENT_FLOOR = "bare client"
"""Title of the row of the floor of `record`."""
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
_MIN_RATE = 0.98 * _RATE
"""Rate of the pushes below which the CPU time means nothing, in frames per second.

On a busy machine frames wait and are then handled together, which takes less time.
"""
_NUMBERS = {
    "/chassis/robot/PoseSpeed": "mileage",
    "/chassis/robot/ScannerData": "robot_id",
    "/chassis/robot/count/StatusCode": "time",
}
"""The field of each type that has the number of the frame."""
_TOOLS = "woosh_robot_agent.tools"


@contextmanager
def _bare_client(port: int, domain: int) -> Iterator[Program]:
    """Run a client that discards all pushes; the block starts when it has subscribed."""
    command = ("benchmarks.floors.client", f"ws://127.0.0.1:{port}")
    with running(*command, domain=domain) as program:
        program.receive()
        yield program


def _push(chassis: Program, first: int, count: int) -> float:
    """Push frames; return their rate, in frames per second."""
    chassis.send("push_mix", _RATE, first, count)
    sent = chassis.receive()["sent"]
    return (count - 1) / (sent[-1] - sent[0])


def _measure(program: Program, chassis: Program, count: int) -> dict[str, float]:
    """Return the CPU time of a program while frames pass, in percent of a core, and their rate."""
    cpu = program.cpu
    rate = _push(chassis, _FIRST, count)
    return {"cpu": 100.0 * (program.cpu - cpu) / (count / _RATE), "rate": rate}


def _has_pushes(path: Path) -> bool:
    """Return True if a file that is being written contains pushes."""
    try:
        with path.open("rb") as file:
            return any(
                getattr(record, "topic", "") in _NUMBERS for record in StreamReader(file).records
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
        found = [
            getattr(message, _NUMBERS[channel.topic])
            for _, channel, _, message in reader.iter_decoded_messages(list(_NUMBERS))
        ]
    lost = len(set(range(_FIRST, _FIRST + count)).difference(found))
    return {"lost": lost, "size": path.stat().st_size / len(found)}


def measure(seconds: float) -> dict[str, dict[str, float]]:
    """Return the figures of both floors and of both kinds of recordings."""
    count = int(_RATE * seconds)
    found = {}
    with (
        own_domain() as domain,
        tempfile.TemporaryDirectory() as folder,
        running_chassis(domain) as (chassis, port),
    ):
        with (
            running("benchmarks.floors.proxy", str(port), domain=domain) as proxy,
            _bare_client(proxy.receive(), domain),
        ):
            _push(chassis, 0, _RATE)
            found[PROXY_FLOOR] = _measure(proxy, chassis, count)
        path = Path(folder, "proxy.mcap")
        robot = ("record", "--ip", f"127.0.0.1:{port}", "--output")
        with running(_TOOLS, *robot, str(path), "--listen", "127.0.0.1:0", domain=domain) as record:
            assert record.process.stdout is not None
            listening = record.process.stdout.readline()
            record.check_running()
            address = listening.split("127.0.0.1:")[-1].split(",")[0]
            with _bare_client(int(address), domain):
                _push(chassis, 0, _RATE)
                found[PROXY] = _measure(record, chassis, count)
            found[PROXY] |= _finish(record, path, count)
        with _bare_client(port, domain) as client:
            _push(chassis, 0, _RATE)
            found[CLIENT_FLOOR] = _measure(client, chassis, count)
        path = Path(folder, "alone.mcap")
        with running(_TOOLS, *robot, str(path), domain=domain) as record:
            while not _has_pushes(path):
                record.check_running()
                _push(chassis, 0, _RATE)
            found[ALONE] = _measure(record, chassis, count)
            found[ALONE] |= _finish(record, path, count)
    return found


def excess(found: dict[str, dict[str, float]]) -> list[str]:
    """Return what is wrong with the figures."""
    problems = [
        f"frames per second of {name}: {figures['rate']:.0f} instead of {_RATE}; end the other "
        "programs on this machine, and measure again"
        for name, figures in found.items()
        if figures["rate"] < _MIN_RATE
    ]
    for name in (PROXY, ALONE):
        figures = found[name]
        if figures["cpu"] > _MAX_CPU:
            problems.append(
                f"CPU of {name}: {figures['cpu']:.1f} % of a core, limit {_MAX_CPU:g} %"
            )
        if figures["lost"]:
            problems.append(f"frames that {name} lost: {figures['lost']:.0f}")
    return problems


def table(found: dict[str, dict[str, float]]) -> str:
    """Return the figures as a Markdown table."""
    rows = [
        (
            name,
            f"{figures['cpu']:.1f} %",
            *(f"{figures[key]:.0f}" if key in figures else "" for key in ("lost", "size")),
        )
        for name, figures in found.items()
    ]
    return markdown(("", "CPU of a core", "frames lost", "bytes per frame"), rows, "lrrr")


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the figures."""
    given = make_parser("recording", __doc__).parse_args(arguments)
    return report(given, measure(1.0 if given.smoke else 20.0), table, excess)
