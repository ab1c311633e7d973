"""The driving demo: a YARP, a ROS 1 and a ROS 2 client in turn send the R1 to rooms of an apartment."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from bridge.client.errors import ClientError
from bridge.client.session import connect
from bridge.config.load import load
from bridge.daemon.workers import worker_kinds
from bridge.demo.processes import Program
from bridge.demo.progress import STILL_SECONDS, DemoRun, PartState
from bridge.demo.sandbox import CLIENT, SYSTEM_PYTHON, Sandbox, roscore, without_rospy
from bridge.demo.shutdown import Shutdown, end_all
from bridge.demo.tracking import RobotTracker
from bridge.shipped import shipped_folder
from bridge.web.section import WebSection
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

CONFIG = shipped_folder() / "configs" / "navigation.yaml"
EXAMPLES = shipped_folder() / "examples"
NEAR = 0.3
"""Distance to a room's place in meters, by ground truth, within which the room counts as reached."""

_STEP, _STANDING_SECONDS = 0.01, 3.0
"""The robot stands if its distance to the room changes by at most this many meters within this many seconds."""

YARP, ROS1, ROS2 = "YARP", "ROS 1", "ROS 2"
_CLIENTS = {YARP: "goto_location_yarp.py", ROS1: "goto_location_rospy.py", ROS2: "goto_location_rclpy.py"}
_WITHOUT_ROSPY = "goto_location_ros1.py"
ROOMS = ("kitchen", "corridor", "bathroom")
"""The rooms for the YARP, the ROS 1 and the ROS 2 client, by default."""

_ENTRY_POINTS = ("/navigation2D_nws_yarp/rpc", "/map2D_nws_yarp/rpc", "/localization2D_nws_yarp/rpc")

Tick = Callable[[str, RobotTracker | None, Sequence[PartState]], None]
"""Called several times a second with the current activity, the robot's tracker once it exists, and the parts."""


@dataclass(frozen=True)
class RoomDrive:
    """One client's drive to a room: distance to the room's place in meters, and the client's last output."""

    client: str
    room: str
    reached: bool
    off: float
    seconds: float
    output: str


@dataclass
class RoomsResult:
    """The results of a run."""

    wanted: int
    drives: list[RoomDrive] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the robot reached every room."""
        return len(self.drives) == self.wanted and all(drive.reached for drive in self.drives)

    def as_dict(self) -> dict[str, Any]:
        """Return the content of the demo's JSON file."""
        return {"ok": self.ok, "seconds": round(self.seconds, 1), "drives": [asdict(drive) for drive in self.drives]}


class RoomsDemo(DemoRun):
    """One run of the demo; calls ``tick`` while it waits."""

    def __init__(self, sandbox: Sandbox, tick: Tick, shutdown: Shutdown) -> None:
        super().__init__(sandbox, shutdown)
        self._tick = tick
        self._programs: list[Program] = []

    @contextmanager
    def started(self) -> Iterator[RobotTracker]:
        """Start the ROS 1 master and the daemon, and track the robot; end everything on exit. Raises `DemoError`."""
        sandbox = self._sandbox
        conf = sandbox.folder / "yarp"
        conf.mkdir(exist_ok=True)
        (conf / "yarp.conf").write_text(f"127.0.0.1 {sandbox.yarp_port} yarp\n", encoding="utf-8")
        try:
            self._launch_roscore_and_daemon()
            self._until(sandbox.master_answers, "the ROS 1 master")
            self._until(lambda: self._parts.up("router"), "the hub's router")
            with self._course() as course:
                self._until(lambda: course.localized, "the robot and its localizer", course)
                names = NameClient(Address("127.0.0.1", sandbox.yarp_port))
                self._until(
                    lambda: all(connections.exists(names, port) for port in _ENTRY_POINTS),
                    "the ports for YARP clients",
                    course,
                )
                yield course
        finally:
            self._stop()

    @contextmanager
    def _course(self) -> Iterator[RobotTracker]:
        """Connect to the hub, with a longer time limit each time, because a busy router responds slowly."""
        self._progress.begin()
        for patience in itertools.chain((0.5, 1.0, 2.0), itertools.repeat(4.0)):
            try:
                with connect(self._sandbox.config, patience) as client:
                    yield RobotTracker(client)
                    return
            except ClientError:
                self._wait("waiting for the hub")
                self._check("the hub")

    def run(self, course: RobotTracker, rooms: Sequence[str] = ROOMS) -> RoomsResult:
        """Let each client send the robot to its room."""
        result = RoomsResult(len(_CLIENTS))
        for client, room in zip(_CLIENTS, rooms, strict=True):
            result.drives.append(self._drive(client, room, course))
            if not result.drives[-1].reached:
                break
        result.seconds = time.monotonic() - self._began
        return result

    @property
    def suggestion(self) -> str:
        """Suggestions for the running demo, in one line."""
        sandbox = self._sandbox
        page = (
            f"http://127.0.0.1:{sandbox.web_port}/ in a browser, or "
            if sandbox.config.section(WebSection).enabled
            else ""
        )
        networks = f"ROS_MASTER_URI={sandbox.master}, ROS_DOMAIN_ID={sandbox.domain}, YARP's names at 127.0.0.1:"
        return (
            f"{page}midspan goto bedroom --router tcp/127.0.0.1:{sandbox.router_port}  ({networks}{sandbox.yarp_port})"
        )

    def stay(self, course: RobotTracker) -> None:
        """Continue until interrupted, or until a part ends."""
        while True:
            self._wait(f"staying: {self.suggestion}; Ctrl-C ends the demo", course)

    def _drive(self, client: str, room: str, course: RobotTracker) -> RoomDrive:
        sandbox = self._sandbox
        python: Path | str = sys.executable
        env, example = sandbox.environment(), _CLIENTS[client]
        if client == ROS1 and without_rospy(sandbox.config, CLIENT):
            example = _WITHOUT_ROSPY
        elif client == ROS1:
            python, env = SYSTEM_PYTHON, sandbox.ros1_environment()
        began = time.monotonic()
        with self._shutdown.held():
            program = Program([python, EXAMPLES / example, room], env, sandbox.folder)
            self._programs.append(program)
        self._progress.begin()
        while program.running and not self._progress.stalled:
            output = program.lines[-1] if program.lines else "starting"
            self._progress.note(client, output)
            self._parts.starting = () if program.lines else (program.pid,)
            self._wait(f"{client} client, to the {room}: {output}", course)
            self._fail_with_a_part()
        self._parts.starting = ()
        output = program.lines[-1] if program.lines else ""
        if program.running:
            output = f"no progress for {STILL_SECONDS:.0f} s: {course.state}; {output}"
            program.begin_stop()
        if program.code == 0:
            wait_for_poses(course, room, lambda: self._wait(f"{client} client, to the {room}: {output}", course))
        off = course.distance_to(room)
        reached = program.code == 0 and off < NEAR
        return RoomDrive(client, room, reached, round(off, 3), round(time.monotonic() - began, 1), output)

    def _until(self, ready: Callable[[], object], what: str, course: RobotTracker | None = None) -> None:
        """Wait for a condition; raises `DemoError` if progress stops or a part failed."""
        self._progress.begin()
        while not _holds(ready):
            self._wait(f"waiting for {what}", course)
            self._check(what)

    def _wait(self, doing: str, course: RobotTracker | None = None) -> None:
        self._check_processes()
        self._parts.refresh(self._progress)
        if course is not None:
            course.refresh(self._progress)
        self._tick(doing, course, self._parts.all)
        time.sleep(0.1)

    def _stop(self) -> None:
        daemon, master = ([self._children[name]] if name in self._children else [] for name in ("daemon", "roscore"))
        end_all(self._sandbox, self._shutdown, ((self._programs, 4.0), (daemon, 9.0), (master, 9.0)))


def wait_for_poses(course: RobotTracker, room: str, wait: Callable[[], None]) -> None:
    """Wait until the robot is near a room's place or stands, because its poses arrive late on a busy machine.

    ``wait`` waits for a moment.
    """
    off, since = course.distance_to(room), time.monotonic()
    while off >= NEAR and time.monotonic() - since < _STANDING_SECONDS:
        wait()
        if abs(course.distance_to(room) - off) > _STEP:
            off, since = course.distance_to(room), time.monotonic()


def overrides(template: Path) -> dict[str, Any]:
    """Return the demo's changes to a configuration: absolute paths of the store's files, no people, and the console."""
    config = load(template)
    files = {"maps": config.store.maps, "locations": config.store.locations}
    return {
        "store": {key: str(file) for key, file in files.items() if file is not None},
        "sim": {"people": False},
        "web": {"enabled": not worker_kinds()["web"].missing(config)},
    }


def replace_ros1(sandbox: Sandbox) -> str:
    """Replace the parts of ROS 1 that this machine lacks with Midspan's; return a line that names them, "" if none."""
    own_master, own_client = roscore(sandbox.config) is None, bool(without_rospy(sandbox.config, CLIENT))
    if own_master:
        sandbox.embed_master()
    lacking = " and no ".join(name for name, lacks in (("roscore", own_master), ("rospy", own_client)) if lacks)
    own = " and ".join(name for name, lacks in (("master", own_master), ("client", own_client)) if lacks)
    return f"ROS 1: Midspan's own {own}, because this machine has no {lacking}" if own else ""


def _holds(ready: Callable[[], object]) -> bool:
    try:
        return bool(ready())
    except (OSError, RuntimeError):
        return False
