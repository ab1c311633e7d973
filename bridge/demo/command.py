"""``midspan demo``: clients of every side send the simulated R1 to rooms; or topics of every side are bridged."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.client.errors import ClientError

if TYPE_CHECKING:
    from bridge.demo.sandbox import Sandbox
    from bridge.demo.shutdown import Shutdown

_IN_EXTRA = ("ROS 2: ", "simulation: ", "zenoh: ")
_EXTRA = (
    "pip install 'midspan[demo]' installs the Python packages of the demo (ROS 2, the simulator, the console and"
    " zenoh-ros2-sdk); in a checkout, make setup installs all of it"
)
_INTERRUPTED = 130
"""Exit code after an interrupt, as in `bridge.demo.shutdown`, whose imports may be what is interrupted."""

_NOT_WINDOWS = (
    "the demo runs only on Linux, because ROS 2's wheels and DART (the simulator) are published only for Linux; run it"
    " on a Linux machine. On Windows, 'midspan run' joins ROS 1, YARP and zenoh (docs/start/pip.md)"
)


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "rooms: a YARP, a ROS 1 and a ROS 2 client in turn send the R1 to named rooms of a simulated apartment, with"
        " only Midspan in between (configs/navigation.yaml); shows the map and the path. topics: a ROS 1 master, the"
        " simulated R1 as a rospy robot, the daemon, and real rclpy, zenoh and YARP programs that subscribe and drive;"
        " shows every route, and checks from the programs' reports that everything was bridged. Both use their"
        " own ports and ROS domain, and leave no process or file on the machine. Exit code 1 if a room was not"
        " reached, or something was not bridged."
    )
    parser.add_argument(
        "what", nargs="?", choices=("rooms", "topics"), default="rooms", help="the demo (default rooms)"
    )
    stay = os.environ.get("STAY", "") not in ("", "0")
    file: Any = {"type": Path, "metavar": "FILE"}
    parser.add_argument(
        "--stay", action="store_true", default=stay, help="continue until Ctrl-C after the checks (STAY=1)"
    )
    parser.add_argument("--json", **file, default=os.environ.get("JSON") or None, help="write the results (JSON=FILE)")
    png = os.environ.get("PNG") or Path("midspan-demo.png")
    parser.add_argument(
        "--png", **file, default=png, help="rooms: file for the path (default midspan-demo.png; PNG=FILE)"
    )
    rooms = ("kitchen", "corridor", "bathroom")
    parser.add_argument(
        "--to", nargs=3, metavar="ROOM", default=rooms, help=f"rooms: one room per client (default {' '.join(rooms)})"
    )
    parser.add_argument(
        "--seconds", type=float, metavar="N", default=20.0, help="topics: minimum duration (default 20)"
    )
    default = "configs/navigation.yaml or configs/demo.yaml"
    parser.add_argument("-c", "--config", **file, help=f"configuration (default {default})")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the demo; return 0 if everything went well."""
    if sys.platform == "win32":  # before the imports, because the demo's process groups and locks are POSIX's
        raise ClientError(_NOT_WINDOWS)
    try:
        from bridge.demo.shutdown import INTERRUPTED, Shutdown
    except KeyboardInterrupt:  # Python would first free all that was imported, which takes seconds on a busy machine
        os._exit(_INTERRUPTED)

    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    with Shutdown() as shutdown:
        try:
            with contextlib.ExitStack() as stack:
                code = _topics(args, shutdown, stack) if args.what == "topics" else _rooms(args, shutdown, stack)
        except KeyboardInterrupt:
            code = INTERRUPTED
    shutdown.exit_if_interrupted(code)
    return code


def _rooms(args: argparse.Namespace, shutdown: Shutdown, stack: contextlib.ExitStack) -> int:
    from bridge.demo import rooms
    from bridge.demo.progress import DemoError
    from bridge.demo.rooms_view import RoomsView
    from bridge.demo.sandbox import missing, too_slow

    template = args.config or rooms.CONFIG
    sandbox = _sandbox(shutdown, stack, template, rooms.overrides(template), ports=False)
    replaced = rooms.replace_ros1(sandbox)
    _require([*missing(sandbox.config), *_simulation(sandbox), *too_slow()])
    with shutdown.held():
        view = stack.enter_context(RoomsView())
    view.print_line(_console(sandbox))
    if replaced:
        view.print_line(replaced)
    result = None
    try:
        demo = rooms.RoomsDemo(sandbox, view.tick, shutdown)
        with demo.started() as course:
            result = demo.run(course, args.to)
            view.show(result, course)
            _draw(course, Path(args.png))
            view.print_line(f"{result.seconds:.0f} s; the path was drawn to {args.png}")
            if args.json is not None:
                _write(args.json, result.as_dict())
            if args.stay:
                view.print_line(f"try: {demo.suggestion}")
                demo.stay(course)
    except DemoError as err:
        raise ClientError(str(err)) from None
    except KeyboardInterrupt:
        if not args.stay or result is None:
            raise
    if not args.stay:
        view.print_line("next: 'STAY=1 make demo' waits for commands; docs/start/quickstart.md: your own robot")
    return 0 if result.ok else 1


def _sandbox(
    shutdown: Shutdown, stack: contextlib.ExitStack, template: Path | None, more: dict[str, Any], *, ports: bool
) -> Sandbox:
    """Return a sandbox for the run; everything that the run leaves on the machine is removed at its end."""
    from bridge.demo.leftovers import erase
    from bridge.demo.sandbox import Sandbox

    def leave_nothing() -> None:
        erase(sandbox.folder, sandbox.domain_ports)
        sandbox.close()

    with shutdown.held():
        sandbox = stack.enter_context(Sandbox(template, more, ports=ports))
        shutdown.guard(leave_nothing)
        stack.callback(shutdown.ignore_signals)
    return sandbox


def _draw(course: Any, file: Path) -> None:
    try:
        course.png(file)
    except (OSError, ValueError) as err:
        raise ClientError(f"cannot write {file}: {err}") from None


def _topics(args: argparse.Namespace, shutdown: Shutdown, stack: contextlib.ExitStack) -> int:
    from bridge.demo.progress import DemoError
    from bridge.demo.sandbox import CONFIG, ROBOT, missing, roscore, too_slow, without_rospy
    from bridge.demo.topics_demo.scenario import TopicsDemo, TopicsResult
    from bridge.demo.topics_demo.view import TopicsView

    template = args.config or (CONFIG if CONFIG.is_file() else None)
    sandbox = _sandbox(shutdown, stack, template, {}, ports=True)
    robot = without_rospy(sandbox.config, ROBOT)
    if roscore(sandbox.config) is None:
        sandbox.embed_master()
    needed = [f"{robot}\nthe robot of this demo is a rospy program; 'midspan demo' needs no rospy"] if robot else []
    _require([*needed, *missing(sandbox.config), *_simulation(sandbox), *too_slow()])
    result = TopicsResult()
    with shutdown.held():
        view = stack.enter_context(TopicsView(sandbox))
    try:
        with TopicsDemo(sandbox, view.tick, shutdown) as demo:
            result = demo.run(args.seconds)
            view.refresh()
            view.explain_failures(result.checks)
            view.print_line(f"checked after {result.seconds:.0f} s")
            if args.stay:
                view.show(result.checks)
                demo.stay()
    except DemoError as err:
        raise ClientError(str(err)) from None
    except KeyboardInterrupt:
        if not args.stay or not result.checks:
            raise
    view.show(result.checks)
    if args.json is not None:
        _write(args.json, {**result.as_dict(), "routes": view.routes()})
    return 0 if result.ok else 1


def _console(sandbox: Sandbox) -> str:
    """Return a line with the address of the console, or the reason why it is off."""
    from bridge.daemon.workers import worker_kinds
    from bridge.web.section import WebSection

    if sandbox.config.section(WebSection).enabled:
        return f"console: http://127.0.0.1:{sandbox.web_port}/ (responds a few seconds after the start)"
    return f"console: off; {worker_kinds()['web'].missing(sandbox.config) or 'the configuration disables it'}"


def _simulation(sandbox: Sandbox) -> list[str]:
    """Return why the simulator cannot run; empty if it can."""
    from sim.environment import available

    reason = available(sandbox.config)
    return [f"simulation: {reason}"] if reason else []


def _require(missing: list[str]) -> None:
    """Raise `ClientError` with everything that is missing, and the cures."""
    if not missing:
        return
    from sim.environment import has_wheel

    lines = ["the demo needs more than this machine has:", *missing]
    complete = has_wheel() and platform.machine() == "x86_64"  # ROS 2's wheels are only for Linux on x86-64
    if complete and any(reason.startswith(_IN_EXTRA) for reason in missing):
        lines.append(_EXTRA)
    raise ClientError("\n".join(lines))


def _write(file: Path, document: dict[str, Any]) -> None:
    try:
        Path(file).write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as err:
        raise ClientError(f"cannot write {file}: {err.strerror}") from None
    print(f"written to {file}", file=sys.stderr)
