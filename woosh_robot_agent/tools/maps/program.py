"""Command line of `maps`."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkError
from woosh_robot_agent.link.config import MIB
from woosh_robot_agent.program import INTERRUPTED
from woosh_robot_agent.tools.maps import commands
from woosh_robot_agent.tools.options import (
    ToolError,
    add_link_options,
    link_arguments,
    link_config,
    run_tool,
    tool_parser,
)

_MAX_FRAME = 256 * MIB
"""Maximum size of a frame with all files of a scene, in bytes."""
_EPILOG = """\
A scene is a site with one map or several. The robot sends and takes scenes as
a whole.

Exit status: 0 if all was done, 1 if the robot refused something, could not be
reached, or a file cannot be used, 2 if the command line is invalid, 130 after
Ctrl-C. A scene whose upload was cut off is unchanged on the robot."""


def main(arguments: Sequence[str] | None = None) -> int:
    """List, download, upload, rename or delete the maps of one robot.

    Returns:
        The exit status, as in `_EPILOG`.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.ip is None:
        parser.error("the following arguments are required: --ip")
    if options.command == "upload" and options.scene and len(options.folders) > 1:
        parser.error("--scene needs exactly one folder")
    config = replace(link_config(parser, options), max_frame_size=_MAX_FRAME)
    # Silence the link's log: the program prints the errors itself.
    logging.getLogger("woosh_robot_agent").addHandler(logging.NullHandler())
    try:
        return run_tool(_run(config, options))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


def _name(text: str) -> str:
    """Return the name of a scene or a map; refuse a blank one."""
    if not text.strip():  # as from an unset shell variable
        raise argparse.ArgumentTypeError("the name is blank")
    return text


def _new_name(text: str) -> str:
    """Return a new name; also refuse a path, because robots name folders after scenes and maps."""
    if "/" in text or text in (".", ".."):
        raise argparse.ArgumentTypeError(f"a name must not be a path: {text}")
    return _name(text)


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(
        "maps", "Back up the maps and marks of a robot, and bring them to a robot.", _EPILOG
    )
    add_link_options(parser, ip_required=False)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    listing = subparsers.add_parser("list", help="print the scenes and maps of the robot")
    listing.add_argument("--json", action="store_true", help="print one JSON list instead of lines")

    download = subparsers.add_parser(
        "download", help="save scenes: the robot's files, maps for nav2, and marks as YAML"
    )
    download.add_argument(
        "names", nargs="*", metavar="SCENE", help="scene to save (default: all scenes)"
    )
    download.add_argument(
        "--output",
        type=Path,
        default=Path(),
        metavar="FOLDER",
        help="folder in which a folder is made for each scene (default: the current folder)",
    )
    download.add_argument("--force", action="store_true", help="replace scenes saved earlier")

    upload = subparsers.add_parser("upload", help="bring saved scenes to the robot")
    upload.add_argument(
        "folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a saved scene"
    )
    upload.add_argument("--scene", type=_new_name, help="name of the scene on the robot")
    upload.add_argument("--force", action="store_true", help="replace scenes that the robot has")

    rename = subparsers.add_parser("rename", help="rename a scene, or with --map one of its maps")
    rename.add_argument("scene", metavar="SCENE")
    rename.add_argument("new_name", type=_new_name, metavar="NEW_NAME")
    rename.add_argument("--map", type=_name, help="map of the scene to rename")

    delete = subparsers.add_parser("delete", help="delete a scene, or with --map one of its maps")
    delete.add_argument("scene", metavar="SCENE")
    delete.add_argument("--map", type=_name, help="map of the scene to delete")
    for command in (listing, download, upload, rename, delete):
        add_link_options(command, for_subparser=True)
    return parser


async def _run(config: LinkConfig, options: argparse.Namespace) -> int:
    try:
        async with ChassisClient(config=config, minimum_timeouts=commands.SLOW_ANSWERS) as chassis:
            await _execute(commands.MapLibrary(chassis), options)
    except LinkError as error:  # while connecting
        hint = f"`doctor {link_arguments(config)}` finds the cause"
        raise ToolError(f"{error}; {hint}") from None
    return 0


async def _execute(library: commands.MapLibrary, options: argparse.Namespace) -> None:
    if options.command == "list":
        await commands.list_maps(library, as_json=options.json)
    elif options.command == "download":
        await commands.download(library, options.names, options.output, force=options.force)
    elif options.command == "upload":
        await commands.upload(library, options.folders, options.scene or "", force=options.force)
    elif options.command == "rename":
        await commands.rename(library, options.scene, options.map or "", options.new_name)
    else:
        await commands.delete(library, options.scene, options.map or "")
