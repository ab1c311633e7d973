"""``midspan interfaces``: builds ROS 2 message packages, and lists the existing ones."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bridge.cli.arguments import add_verb, add_verbs
from bridge.cli.output import CliError, print_json
from bridge.interfaces.builder import build, build_bundled
from bridge.interfaces.cache import BuildCache, default_cache, environment, link_into_venv, members
from bridge.interfaces.definition import BuildError
from bridge.interfaces.folders import bundled_packages, read_folders
from bridge.interfaces.ros2 import Ros2
from bridge.text import make_console


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(
        parser,
        "Builds ROS 2 message packages from .msg, .srv and .action files with gcc and without colcon, into a cache that"
        " all programs of this user share ($MIDSPAN_CACHE, else ~/.cache/midspan/interfaces).",
        dest="action",
    )
    make = add_verb(
        verbs, "build", run, "build packages; without a folder, those that Midspan always needs",
        "Builds the packages of the folders and their dependencies, and prints the `export` lines for programs that use"
        " them. Without a folder: builds tf2_msgs, nav2_msgs and the others that come with Midspan, and makes them"
        " importable in this virtual environment.", hub=False,
    )  # fmt: skip
    make.add_argument("folders", nargs="*", type=Path, metavar="FOLDER", help="the folder of a package, or of packages")
    show = add_verb(verbs, "list", run, "list the message packages that are installed or built", hub=False)
    for verb in (make, show):
        verb.add_argument("--cache", type=Path, metavar="FOLDER", help="folder of the cache")
        verb.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    if args.action == "build" and sys.platform == "win32":
        raise CliError("message packages are built only on Linux, with gcc and ROS 2's generators; build them there")
    try:
        return _list(args) if args.action == "list" else _build(args)
    except BuildError as err:
        raise CliError(str(err)) from None


def _build(args: argparse.Namespace) -> int:
    if args.folders:
        prefix = build(read_folders(args.folders), args.cache, _report)
        linked = None
    else:
        prefix = build_bundled(args.cache, _report)
        linked = link_into_venv(prefix)
    packages = sorted(members(prefix))
    if args.json:
        print_json({"prefix": str(prefix), "packages": packages, "linked": str(linked) if linked else None})
    elif linked:
        print(f"interfaces: {', '.join(packages) or 'all installed'}")
    else:
        print(f"# {', '.join(packages) or 'all installed'}; to use them in programs of your own:")
        variables = environment([prefix])
        for name in ("PYTHONPATH", "AMENT_PREFIX_PATH"):
            print(f"export {name}={variables[name]}")
    return 0


def _report(line: str) -> None:
    print(f"interfaces: {line}", file=sys.stderr, flush=True)


def _list(args: argparse.Namespace) -> int:
    installed = Ros2.find().packages
    rows = [
        {"package": name, "state": "installed", "version": package.version, "prefix": str(package.prefix)}
        for name, package in installed.items()
    ]
    for prefix in BuildCache(args.cache or default_cache()).packages():
        name, _, key = prefix.name.rpartition("-")
        rows.append({"package": name, "state": "built", "version": key, "prefix": str(prefix)})
    listed = {row["package"] for row in rows}
    rows += [
        {"package": name, "state": "missing", "version": "", "prefix": ""}
        for name in bundled_packages()
        if name not in listed
    ]
    rows.sort(key=lambda row: (row["package"], row["state"]))
    if args.json:
        print_json(rows)
    else:
        _show(rows)
    return 0


def _show(rows: list[dict[str, str]]) -> None:
    from rich.table import Table

    table = Table("PACKAGE", "STATE", "VERSION", "WHERE", box=None, pad_edge=False)
    for row in rows:
        table.add_row(row["package"], row["state"], row["version"], row["prefix"])
    make_console().print(table)
    if any(row["state"] == "missing" for row in rows):
        print("To build the missing packages: `midspan interfaces build`")
