"""``midspan demo``: the simulated R1 sent to rooms by clients of every side; or topics of every side, bridged."""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "demo",
        help="a simulated robot sent to rooms by YARP, ROS 1 and ROS 2 clients",
        description="rooms: the R1 drives in a simulated apartment to named rooms, sent by a YARP, a ROS 1 and a ROS 2"
        " client in turn, with nothing but Midspan in between (configs/navigation.yaml); shows the map and the way."
        " topics: a real roscore and a ROS 1 robot (simulated: laser, odometry, tf, map, camera, obeys /cmd_vel), the"
        " daemon, real rclpy, zenoh and YARP programs, which listen and drive; shows every route and checks by what the"
        " programs report that everything crossed. All on ports and a ROS domain of its own; nothing is left behind."
        " Exit code 1 where a room was not reached, or something did not cross.",
    )
    parser.add_argument("what", nargs="?", choices=("rooms", "topics"), default="rooms", help="default rooms")
    parser.add_argument(
        "--stay",
        action="store_true",
        default=os.environ.get("STAY", "") not in ("", "0"),
        help="go on until Ctrl-C instead of ending after the checks (or STAY=1)",
    )
    parser.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        default=os.environ.get("JSON") or None,
        help="also write what was seen to a file (or JSON=FILE)",
    )
    parser.add_argument(
        "--png",
        type=Path,
        metavar="FILE",
        default=os.environ.get("PNG") or Path("midspan-demo.png"),
        help="rooms: where to draw the map with the way (default midspan-demo.png, or PNG=FILE)",
    )
    parser.add_argument(
        "--to",
        nargs=3,
        metavar="ROOM",
        default=("kitchen", "corridor", "bathroom"),
        help="rooms: where the YARP, the ROS 1 and the ROS 2 client send the robot (default kitchen corridor bathroom)",
    )
    parser.add_argument(
        "--seconds", type=float, metavar="N", default=20.0, help="topics: how long to run at least (default 20)"
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="the daemon's configuration (default configs/navigation.yaml; topics: configs/demo.yaml)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the demo; 0 where everything went well."""
    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    return _topics(args) if args.what == "topics" else _rooms(args)


def _rooms(args: argparse.Namespace) -> int:
    from bridge.demo import requirements, rooms
    from bridge.demo.place import Place
    from bridge.demo.rooms_view import RoomsView
    from bridge.demo.scenario import DemoError

    template = args.config or rooms.CONFIG
    with Place(template, rooms.laid_over(template), ports=False) as here:
        _require(requirements.missing(here.config))
        result = None
        with RoomsView() as view:
            try:
                demo = rooms.Rooms(here, view.tick)
                with demo.started() as course:
                    result = demo.run(course, args.to)
                    view.show(result, course)
                    _draw(course, Path(args.png))
                    view.say(f"{result.seconds:.0f} s; the way is drawn in {args.png}")
                    if args.json is not None:
                        _write(args.json, result.as_dict())
                    if args.stay:
                        demo.stay(course)
            except DemoError as err:
                raise CliError(str(err)) from None
            except KeyboardInterrupt:
                if not args.stay or result is None:
                    raise
    return 0 if result.ok else 1


def _draw(course: Any, file: Path) -> None:
    try:
        course.png(file)
    except (OSError, ValueError) as err:
        msg = f"cannot write {file}: {err}"
        raise CliError(msg) from None


def _topics(args: argparse.Namespace) -> int:
    from bridge.demo import place, requirements
    from bridge.demo.scenario import Demo, DemoError, Result
    from bridge.demo.view import View

    template = args.config or (place.CONFIG if place.CONFIG.is_file() else None)
    with place.Place(template) as here:
        _require(requirements.missing(here.config))
        result = Result()
        with View(here) as view:
            try:
                with Demo(here, view.tick) as demo:
                    result = demo.run(args.seconds)
                    view.look()
                    view.ask_why(result.checks)
                    view.say(f"checked after {result.seconds:.0f} s")
                    if args.stay:
                        view.show(result.checks)
                        demo.stay()
            except DemoError as err:
                raise CliError(str(err)) from None
            except KeyboardInterrupt:
                if not args.stay or not result.checks:
                    raise
        view.show(result.checks)
        if args.json is not None:
            _write(args.json, {**result.as_dict(), "routes": view.routes()})
    return 0 if result.ok else 1


def _require(lacking: list[str]) -> None:
    if lacking:
        raise CliError("\n".join(["the demo needs more than this machine has:", *lacking]))


def _interrupt(_number: int, _frame: object) -> None:
    raise KeyboardInterrupt


def _write(file: Path, document: dict[str, Any]) -> None:
    try:
        Path(file).write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as err:
        msg = f"cannot write {file}: {err.strerror}"
        raise CliError(msg) from None
    print(f"written to {file}", file=sys.stderr)
