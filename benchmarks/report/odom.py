"""Measure how far odom is from the pose of the simulated robot, between its reports too.

scripts/bench --odom            drive for 33 s and print the figures
scripts/bench --odom --json     print one JSON object instead of the table
scripts/bench --odom --smoke    drive for seconds, to check that the benchmark works
scripts/bench --odom --docs     also write table and picture of docs/standard_topics.md

The robot reports its pose as often as the profile of the simulator says, every 0.204 s by default.
Two agents follow it: one predicts odom between the reports, the other one does not. Each message is
compared with the pose of the robot at the stamp of the message. Only messages of a moving robot
count, because that of a standing one has no error.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
from collections.abc import Sequence
from itertools import pairwise

from benchmarks.measurements.odom import DRIVE, LAST, ODOM, REPORTS, SMOKE_DRIVE, Drive, drive
from benchmarks.report.pages import DOCS, write_part
from benchmarks.report.table import markdown


def at_share(values: Sequence[float], share: float) -> float:
    """Return the value that this share of all values does not exceed."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else math.nan


def figures(result: Drive) -> dict[str, dict[str, float]]:
    """Return all figures, in mm, mrad and ms."""
    found = {
        name: {
            "messages": float(len(errors.stamps)),
            "position_median": at_share(errors.position, 0.5) * 1e3,
            "position_99": at_share(errors.position, 0.99) * 1e3,
            "heading_median": at_share(errors.heading, 0.5) * 1e3,
            "heading_99": at_share(errors.heading, 0.99) * 1e3,
        }
        for name, errors in result.errors.items()
    }
    gaps = [other - one for (one, _), (other, _) in pairwise(result.predicted)]
    found["times"] = {
        "interval_median": statistics.median(gaps) * 1e3,
        "interval_99": at_share(gaps, 0.99) * 1e3,
        "stamp_delay_median": at_share(result.delays, 0.5) * 1e3,
        "stamp_delay_99": at_share(result.delays, 0.99) * 1e3,
    }
    return found


def table(found: dict[str, dict[str, float]]) -> str:
    """Return the figures of the errors as a table."""
    labels = {
        ODOM: "odom, at 20 Hz",
        REPORTS: "the reports, each at its own stamp",
        LAST: "the last report, at 20 Hz",
    }
    rows = [
        (
            label,
            f"{found[name]['messages']:.0f}",
            f"{found[name]['position_median']:.1f} mm",
            f"{found[name]['position_99']:.1f} mm",
            f"{found[name]['heading_median']:.1f} mrad",
            f"{found[name]['heading_99']:.1f} mrad",
        )
        for name, label in labels.items()
    ]
    header = ("", "messages", "position, median", "99 %", "heading, median", "99 %")
    return markdown(header, rows, "lrrrrr")


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench --odom",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, not a table")
    parser.add_argument(
        "--smoke", action="store_true", help="drive for seconds, only to see that it works"
    )
    parser.add_argument(
        "--docs", action="store_true", help="write table and picture of docs/standard_topics.md"
    )
    parser.add_argument(
        "--profile", default="tr200", help="profile of the simulated robot (default tr200)"
    )
    given = parser.parse_args(arguments)
    if given.docs:
        if given.smoke:
            parser.error("--docs cannot be combined with --smoke, whose figures mean nothing")
        # imported before the drive, so that a missing matplotlib is noticed at once
        from benchmarks.report import odom_plot
    result = drive(SMOKE_DRIVE if given.smoke else DRIVE, given.profile)
    found = figures(result)
    if given.json:
        print(json.dumps(found))
        return 0
    print(table(found))
    times = found["times"]
    print(
        f"\nInterval between messages: median {times['interval_median']:.1f} ms, "
        f"99 % {times['interval_99']:.1f} ms. "
        f"Delay of the stamp of a report: median {times['stamp_delay_median']:.1f} ms, "
        f"99 % {times['stamp_delay_99']:.1f} ms."
    )
    if given.docs:
        write_part("odom", table(found), DOCS / "standard_topics.md")
        odom_plot.draw(DOCS / "odom.svg", result)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
