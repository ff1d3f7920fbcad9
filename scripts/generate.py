"""Regeneration of derived files and tables: `python3 -m scripts.generate`.

Files are replaced as a whole. Interface files (.msg, .srv, .action) that nothing defines any more
are removed. Tables in README.md and docs/ stand between the lines

    <!-- generated: NAME -->
    <!-- end -->

where NAME is one of `TABLES`. With `--check` nothing is written: the out-of-date files are listed,
and the exit status is 1 if there are any. It works in a source checkout only.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

import yaml

from scripts import simulator_tables, sros2_policies, vda5050_tables
from scripts.interface_files import InterfaceError, interface_files, superfluous_files
from scripts.markdown_table import table
from woosh_robot_agent import endpoints, parameters
from woosh_robot_agent.robot import status_codes
from woosh_robot_agent.ros import standard_endpoints
from woosh_robot_agent.simulator import faults
from woosh_robot_agent.simulator.command_line import make_parser as simulator_parser
from woosh_robot_agent.tools.dashboard import program as dashboard
from woosh_robot_agent.tools.options import add_link_options
from woosh_robot_agent.tools.recording import record, replay

ROOT = Path(__file__).resolve().parents[1]
"""Root of the source checkout."""
COMMAND = "python3 -m scripts.generate"
"""The command that regenerates everything."""


def options_table(parser: argparse.ArgumentParser) -> str:
    """Return the options of a program as a Markdown table."""
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        names = ", ".join(f"`{name}`" for name in action.option_strings)
        default = "" if action.default in (None, [], False, 0) else f"`{action.default}`"
        choices = f" ({', '.join(action.choices)})" if action.choices else ""
        rows.append((names, default, f"{action.help}{choices}"))
    return table(("Option", "Default", "Meaning"), rows)


def link_parser() -> argparse.ArgumentParser:
    """Return a parser with the options of the link, which the tools share."""
    parser = argparse.ArgumentParser()
    add_link_options(parser)
    return parser


def options_list(parser: argparse.ArgumentParser, *, without: Collection[str] = ()) -> str:
    """Return options as a Markdown list, with their help, which has the defaults.

    Args:
        parser: the parser with the options.
        without: attribute names (`dest`) of options to leave out.
    """
    return "\n".join(
        f"- `{action.option_strings[0]}`: {str(action.help) % {**vars(action), 'prog': ''}}"
        for action in parser._actions
        if action.option_strings and action.dest not in ("help", *without)
    )


def tool_options(parser: argparse.ArgumentParser) -> str:
    """Return the options of a tool, except those of the link, as a Markdown list."""
    return options_list(parser, without={action.dest for action in link_parser()._actions})


def status_codes_json() -> str:
    """Return the table of status codes as JSON, which is read much faster than YAML."""
    codes = yaml.safe_load((ROOT / "tests/facts/status_codes.yaml").read_text("utf-8"))
    return json.dumps({str(code): text for code, text in codes.items()}, indent=0) + "\n"


FILES: dict[str, Callable[[], str]] = {
    "config/agent.yaml": parameters.yaml,
    "config/agent.policy.xml": sros2_policies.agent_policy,
    "config/client.policy.xml": sros2_policies.client_policy,
    str(status_codes.TABLE.relative_to(ROOT)): status_codes_json,
}
"""Generated files, except the interface files: path, and the function that returns the content."""

TABLES: dict[str, Callable[[], str]] = {
    "endpoints": endpoints.markdown,
    "standard-topics": lambda: standard_endpoints.markdown(standard_endpoints.STANDARD),
    "nav2": lambda: standard_endpoints.markdown(standard_endpoints.NAV2),
    "parameters": parameters.markdown,
    "link-options": lambda: options_list(link_parser()),
    "dashboard-options": lambda: tool_options(dashboard.make_parser()),
    "record-options": lambda: tool_options(record.make_parser()),
    "replay-options": lambda: tool_options(replay.make_parser()),
    "simulator-options": lambda: options_table(simulator_parser()),
    "simulator-faults": faults.markdown,
    "simulator-profile": simulator_tables.profile_table,
    "simulator-refusals": simulator_tables.refusals_table,
    "simulator-requests": simulator_tables.requests_table,
    "simulator-scene": simulator_tables.scene_table,
    "vda5050-actions": vda5050_tables.actions,
    "vda5050-errors": vda5050_tables.errors,
    "vda5050-fields": vda5050_tables.fields,
    "vda5050-names": vda5050_tables.names,
}
"""Generated tables: name in the marker, and the function that returns the Markdown."""

_BLOCK = re.compile(
    r"(?P<begin>^<!-- generated: (?P<name>\S+) -->\n).*?(?P<end>^<!-- end -->$)", re.M | re.S
)


def pages(root: Path) -> list[Path]:
    """Return the pages that may hold generated tables."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def with_tables(text: str) -> str:
    """Return the text of a page with its generated tables up to date.

    Raises:
        ValueError: the page has a table of an unknown name.
    """

    def replace(block: re.Match[str]) -> str:
        if block["name"] not in TABLES:
            raise ValueError(f"unknown table {block['name']!r}; the names are {', '.join(TABLES)}")
        return f"{block['begin']}{TABLES[block['name']]()}\n{block['end']}"

    return _BLOCK.sub(replace, text)


def outdated(root: Path) -> Iterator[tuple[Path, str | None]]:
    """Yield each file that is out of date, with its content; None if it should not exist.

    Raises:
        InterfaceError: the interface files cannot be generated.
    """
    interfaces = interface_files(root / "proto")
    files = interfaces | {name: content() for name, content in FILES.items()}
    for name, wanted in files.items():
        path = root / name
        if not path.exists() or path.read_text() != wanted:
            yield path, wanted
    for path in superfluous_files(root, interfaces):
        yield path, None
    for path in pages(root):
        text = path.read_text()
        wanted = with_tables(text)
        if text != wanted:
            yield path, wanted


def main(arguments: Sequence[str] | None = None) -> int:
    """Regenerate or check all files; return the exit status."""
    parser = argparse.ArgumentParser(
        prog=COMMAND, description="Regenerate the files and tables that derive from the code."
    )
    parser.add_argument("--check", action="store_true", help="only list files that are out of date")
    options = parser.parse_args(arguments)
    if not (ROOT / "setup.py").exists():
        parser.error(f"this is not a source checkout: {ROOT}")
    try:
        found = list(outdated(ROOT))
    except InterfaceError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")
    for path, wanted in found:
        if options.check:
            print(f"{path.relative_to(ROOT)} is out of date; run {COMMAND}")
        elif wanted is None:
            path.unlink()
            print(f"removed {path.relative_to(ROOT)}")
        else:
            path.parent.mkdir(exist_ok=True)
            path.write_text(wanted)
            print(f"wrote {path.relative_to(ROOT)}")
    return 1 if options.check and found else 0


if __name__ == "__main__":
    sys.exit(main())
