"""The demo that drives: a YARP, a ROS 1 and a ROS 2 client in turn send the R1 to rooms of an apartment."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError
from bridge.cli.hubclient import connect
from bridge.config.load import load
from bridge.demo import requirements
from bridge.demo.child import Child, guarded
from bridge.demo.course import Course
from bridge.demo.place import Place
from bridge.demo.program import Program
from bridge.demo.scenario import DemoError
from bridge.demo.traces import remove_unused, shared_memory, sweep
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

_log = logging.getLogger(__name__)

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "navigation.yaml"
EXAMPLES = ROOT / "examples"
START_SECONDS, DRIVE_SECONDS = 40.0, 150.0
NEAR = 0.3
"""Metres from a room's place within which the robot is there, in truth."""

YARP, ROS1, ROS2 = "YARP", "ROS 1", "ROS 2"
_CLIENTS = {YARP: "goto_location_yarp.py", ROS1: "goto_location_rospy.py", ROS2: "goto_location_rclpy.py"}
ROOMS = ("kitchen", "corridor", "bathroom")
"""Where a YARP, a ROS 1 and a ROS 2 client send the robot, unless told otherwise."""

_DOORS = ("/navigation2D_nws_yarp/rpc", "/map2D_nws_yarp/rpc", "/localization2D_nws_yarp/rpc")

Tick = Callable[[str, Course], None]
"""Called several times a second with what the demo is at."""


@dataclass(frozen=True)
class Drive:
    """What came of one.

    Attributes:
        client: who asked.
        room: where to.
        reached: whether the client was told so, and the robot is there.
        off: metres from the room's place to the robot, in truth.
        seconds: from the client's start to its end.
        said: the client's last words.
    """

    client: str
    room: str
    reached: bool
    off: float
    seconds: float
    said: str


@dataclass
class Result:
    """What a run showed."""

    wanted: int
    drives: list[Drive] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the robot came to every room."""
        return len(self.drives) == self.wanted and all(drive.reached for drive in self.drives)

    def as_dict(self) -> dict[str, Any]:
        """As it stands in the demo's JSON file."""
        return {"ok": self.ok, "seconds": round(self.seconds, 1), "drives": [asdict(drive) for drive in self.drives]}


class Rooms:
    """The processes of one run.

    Args:
        place: where it runs.
        tick: called while anything is waited for.
    """

    def __init__(self, place: Place, tick: Tick) -> None:
        self._place, self._tick = place, tick
        self._children: dict[str, Child] = {}
        self._programs: list[Program] = []
        self._began = time.monotonic()

    @contextmanager
    def started(self) -> Iterator[Course]:
        """Roscore and the daemon, and a look at the robot; all is ended in the end. Raises `DemoError`."""
        place, packages = self._place, requirements.ros1_packages(self._place.config)
        conf = place.folder / "yarp"
        conf.mkdir(exist_ok=True)
        (conf / "yarp.conf").write_text(f"127.0.0.1 {place.yarp_port} yarp\n", encoding="utf-8")
        try:
            system = requirements.SYSTEM_PYTHON
            master = guarded(system, requirements.roscore(place.config), "-p", str(place.master_port))
            self._children["roscore"] = Child("roscore", master, place.ros1_environment(packages), place.folder)
            daemon = guarded(sys.executable, "-m", "bridge.cli.main", "run", "--config", place.config_file)
            self._children["daemon"] = Child("daemon", daemon, place.environment(), place.folder)
            with self._course() as course:
                self._until(place.master_answers, "roscore", course)
                self._until(lambda: course.localized, "the robot and its localiser", course)
                names = NameClient(Address("127.0.0.1", place.yarp_port))
                self._until(
                    lambda: all(connections.exists(names, door) for door in _DOORS),
                    "the doors for YARP's clients",
                    course,
                )
                yield course
        finally:
            self._stop()

    @contextmanager
    def _course(self) -> Iterator[Course]:
        end = time.monotonic() + START_SECONDS
        while True:
            self._look()
            try:
                with connect(self._place.config, 0.5) as client:
                    yield Course(client)
                    return
            except CliError:
                if time.monotonic() > end:
                    raise DemoError(f"the daemon is not up:\n{self._children['daemon'].last_words()}") from None
                time.sleep(0.2)

    def run(self, course: Course, rooms: Sequence[str] = ROOMS) -> Result:
        """Have each client send the robot to its room."""
        result = Result(len(rooms))
        for client, room in zip(_CLIENTS, rooms, strict=True):
            result.drives.append(self._drive(client, room, course))
            if not result.drives[-1].reached:
                break
        result.seconds = time.monotonic() - self._began
        return result

    def stay(self, course: Course) -> None:
        """Go on until interrupted, or until a part ends."""
        router = f"tcp/127.0.0.1:{self._place.router_port}"
        while True:
            self._wait(f"staying: midspan goto bedroom --router {router}; Ctrl-C ends the demo", course)

    def _drive(self, client: str, room: str, course: Course) -> Drive:
        place = self._place
        python: Path | str = sys.executable
        env = place.environment()
        if client == ROS1:
            python = requirements.SYSTEM_PYTHON
            env = place.ros1_environment(requirements.ros1_packages(place.config))
        began = time.monotonic()
        program = Program([python, EXAMPLES / _CLIENTS[client], room], env, place.folder)
        self._programs.append(program)
        while program.code is None and time.monotonic() - began < DRIVE_SECONDS:
            said = program.lines[-1] if program.lines else "asks"
            self._wait(f"{client} client, to the {room}: {said}", course)
        program.stop()
        off = course.off(room)
        reached = program.code == 0 and off < NEAR
        words = program.lines[-1] if program.lines else ""
        said = words if reached or time.monotonic() - began < DRIVE_SECONDS else f"not there in time; {words}"
        return Drive(client, room, reached, round(off, 3), round(time.monotonic() - began, 1), said)

    def _until(self, ready: Callable[[], object], what: str, course: Course) -> None:
        end = time.monotonic() + START_SECONDS
        while not _holds(ready):
            if time.monotonic() > end:
                raise DemoError(f"{what} is not there:\n{self._children['daemon'].last_words()}")
            self._wait(f"waiting for {what}", course)

    def _wait(self, doing: str, course: Course) -> None:
        self._look()
        course.look()
        self._tick(doing, course)
        time.sleep(0.1)

    def _look(self) -> None:
        for child in self._children.values():
            if not child.running:
                raise DemoError(f"{child.name} ended before its time:\n{child.last_words()}")

    def _stop(self) -> None:
        memory = shared_memory(self._place.folder, self._place.domain_ports)
        for program in self._programs:
            program.stop()
        for name in ("daemon", "roscore"):
            if name in self._children:
                self._children[name].begin_stop()
                self._children[name].finish_stop(9.0)
        left = sweep(self._place.folder)
        if left:
            _log.warning("these processes had to be killed: %s", ", ".join(left))
        remove_unused(memory)


def laid_over(template: Path) -> dict[str, Any]:
    """What the demo changes of a configuration: the store's files by their whole paths, and nobody to wait for."""
    store = load(template).store
    files = {"maps": store.maps, "locations": store.locations}
    return {"store": {key: str(file) for key, file in files.items() if file is not None}, "sim": {"people": False}}


def _holds(ready: Callable[[], object]) -> bool:
    try:
        return bool(ready())
    except (OSError, RuntimeError):
        return False
