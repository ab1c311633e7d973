"""One run of the demo: start the real programs and the daemon, let them drive, look what crossed, end everything."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from bridge.demo import requirements, topics
from bridge.demo.checks import ROS1, ROS2, YARP, YARP_TEXT, ZENOH, Check, Drive, evaluate
from bridge.demo.child import Child, guarded
from bridge.demo.place import Place
from bridge.demo.traces import remove_unused, shared_memory, sweep

_log = logging.getLogger(__name__)

START_SECONDS = 20.0
"""How long the programs may take to be up, and then to hear of each other."""

SHOW_SECONDS = 20.0
"""How long a run lasts at least, so that a person sees the table move."""

ASK_AGAIN = 1.5
"""Seconds after which a late one that heard nothing asks once more."""

LATE_SECONDS = 5.0
"""How long what was said before is waited for by each one that joins late."""

CROSS_SECONDS = 10.0
"""How long what has not crossed is waited for in the end."""

SILENCE = 1.0
"""Seconds after a drive; the robot must stand after half of it."""

REPORT_SECONDS = 5.0
"""How long the robot's report of how it is then is waited for, on a busy machine."""

Tick = Callable[[str], None]
"""Called several times a second with what the demo is at."""


class DemoError(RuntimeError):
    """The demo could not even start; says what is missing and how to mend it."""


@dataclass
class Result:
    """What a run showed."""

    checks: list[Check] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether all that should cross did."""
        return bool(self.checks) and all(check.ok for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """As it stands in the demo's JSON file."""
        return {"ok": self.ok, "seconds": round(self.seconds, 1), "checks": [check.as_dict() for check in self.checks]}


class Demo:
    """The processes of one run, from entering the context to leaving it.

    Args:
        place: where it runs.
        tick: called while anything is waited for.
    """

    def __init__(self, place: Place, tick: Tick) -> None:
        self._place, self._tick = place, tick
        self._children: dict[str, Child] = {}
        self._drives: list[Drive] = []
        self._began = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.stop()

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self, seconds: float = SHOW_SECONDS) -> Result:
        """Start, drive, check; raises `DemoError` where a part does not start.

        Args:
            seconds: how long to go on at least.
        """
        self._start()
        self._wait_until_joined()
        for program in (ROS2, ZENOH, YARP):
            self._join_late(program)
        self._drive(ROS2, 0.3, 0.0, 2.5)
        self._drive(ZENOH, 0.0, 0.8, 2.0)
        self._drive(YARP, -0.3, 0.0, 2.0)
        self._drive(YARP_TEXT, 0.0, -0.8, 1.5)
        end = time.monotonic() + CROSS_SECONDS
        while not self.result().ok and time.monotonic() < end:
            self._wait(0.25, "waiting for what has not crossed yet")
        self._wait(seconds - (time.monotonic() - self._began), "the programs go on listening")
        return self.result()

    def result(self) -> Result:
        """How it stands now."""
        reports = {name: self._children[name].report for name in (ROS1, ROS2, ZENOH, YARP)}
        return Result(evaluate(reports, self._drives), time.monotonic() - self._began)

    def stay(self) -> None:
        """Go on until interrupted, or until a part ends."""
        while all(child.running for child in self._children.values()):
            self._wait(0.5, "staying; Ctrl-C ends the demo")
        dead = next(child for child in self._children.values() if not child.running)
        msg = f"{dead.name} has ended:\n{dead.last_words()}"
        raise DemoError(msg)

    # -- parts ---------------------------------------------------------------------------------------------------------

    def _start(self) -> None:
        place, python = self._place, sys.executable
        packages = requirements.ros1_packages(place.config)
        ros1, own = place.ros1_environment(packages), place.environment()
        system = requirements.SYSTEM_PYTHON
        master = guarded(system, requirements.roscore(place.config), "-p", str(place.master_port))
        self._launch("roscore", master, ros1)
        self._launch("daemon", guarded(python, "-m", "bridge.cli.main", "run", "--config", place.config_file), own)
        self._launch(ROS2, [python, "-m", "bridge.demo.ros2_program"], own)
        zenoh = [python, "-m", "bridge.demo.zenoh_program", str(place.router_port), str(place.config.hub.domain)]
        self._launch(ZENOH, zenoh, own)
        self._launch(YARP, [python, "-m", "bridge.demo.yarp_program", str(place.yarp_port)], own)
        self._wait_for_master()
        self._launch(ROS1, [system, "-m", "bridge.demo.robot"], ros1)
        for program in (ROS1, ROS2, ZENOH, YARP):
            self._wait_for(program, "ready", START_SECONDS, f"starting {program}")

    def _launch(self, name: str, command: list[Any], env: dict[str, str]) -> None:
        self._children[name] = Child(name, command, env, self._place.folder)

    def _wait_for_master(self) -> None:
        if not self._until(self._place.master_answers, START_SECONDS, 0.1, "starting roscore"):
            msg = f"roscore does not answer at {self._place.master}:\n{self._children['roscore'].last_words()}"
            raise DemoError(msg)

    def _wait_until_joined(self) -> None:
        """Until each listener heard something of the robot; what never crosses is the checks' to tell."""
        listeners = [self._children[program] for program in (ROS2, ZENOH, YARP)]
        self._until(
            lambda: all(_heard_anything(child.report) for child in listeners),
            START_SECONDS,
            0.2,
            "waiting for the first messages to cross",
        )

    def _join_late(self, program: str) -> None:
        """Have a program listen to what was said long ago, and wait a moment for that.

        zenoh-ros2-sdk asks once for what is kept, and on a busy machine before it is told who keeps it; so its program
        comes second, and asks again.
        """
        child, end, again = self._children[program], time.monotonic() + LATE_SECONDS, 0.0
        while time.monotonic() < end:
            if not again or (program == ZENOH and time.monotonic() > again):
                child.ask("join_late")
                again = time.monotonic() + ASK_AGAIN
            heard = child.report.get("heard", {})
            if all(heard.get(topic, {}).get("count") for topic in (topics.MAP, topics.TF_STATIC)):
                return
            self._wait(0.1, f"{program} joins late")

    def _drive(self, source: str, linear: float, angular: float, seconds: float) -> None:
        text = source == YARP_TEXT
        program, more = (YARP, {"text": True}) if text else (source, {})
        robot, driver = self._children[ROS1], self._children[program]
        before, received = robot.report.get("pose", [0.0] * 3), _received(robot.report)
        driver.ask("drive", linear=linear, angular=angular, seconds=seconds, **more)
        drove = self._wait_for(program, "drove", seconds + 5.0, f"{source} drives the robot") or {}
        self._wait(SILENCE, "the driver is silent")
        silent = time.monotonic()
        self._until(lambda: robot.report.get("time", 0.0) > silent, REPORT_SECONDS, 0.05, "the driver is silent")
        self._drives.append(
            Drive(
                source,
                (linear, angular),
                before,
                robot.report.get("pose", before),
                _received(robot.report) - received,
                drove.get("sent", 0),
                robot.report.get("velocity", [0.0, 0.0]),
                _moved(drove.get("before"), driver.report.get("pose")),
            )
        )

    # -- waiting -------------------------------------------------------------------------------------------------------

    def _until(self, ready: Callable[[], bool], seconds: float, every: float, doing: str) -> bool:
        """Wait for something, so long at most; whether it came. What never comes is the checks' to tell."""
        end = time.monotonic() + seconds
        while not ready():
            if time.monotonic() > end:
                return False
            self._wait(every, doing)
        return True

    def _wait_for(self, name: str, event: str, seconds: float, doing: str) -> dict[str, Any] | None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._look(doing)
            told = self._children[name].wait_for(event, 0.2)
            if told is not None:
                return told
        return None

    def _wait(self, seconds: float, doing: str) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._look(doing)
            time.sleep(min(left, 0.2))

    def _look(self, doing: str) -> None:
        for child in self._children.values():
            if not child.running:
                msg = f"{child.name} ended before its time:\n{child.last_words()}"
                raise DemoError(msg)
        self._tick(doing)

    # -- the end -------------------------------------------------------------------------------------------------------

    def stop(self) -> None:
        """End all processes, those that depend on others first. Safe to call twice."""
        memory = shared_memory(self._place.folder, self._place.domain_ports)
        for group, patience in (((ZENOH, ROS2, ROS1), 4.0), (("daemon",), 9.0), (("roscore",), 9.0)):
            children = [self._children[name] for name in group if name in self._children]
            for child in children:
                child.begin_stop()
            for child in children:
                child.finish_stop(patience)
        self._children = {}
        left = sweep(self._place.folder)
        if left:
            _log.warning("these processes had to be killed: %s", ", ".join(left))
        forgotten = remove_unused(memory)
        if forgotten:
            _log.info("removed from shared memory: %s", ", ".join(map(str, forgotten)))


def _heard_anything(report: dict[str, Any]) -> bool:
    heard = report.get("heard", {})
    return any(heard.get(topic, {}).get("count") for topic in (topics.ODOM, topics.TF, topics.SCAN))


def _received(report: dict[str, Any]) -> int:
    count: int = report.get("heard", {}).get(topics.CMD_VEL, {}).get("count", 0)
    return count


def _moved(before: list[float] | None, after: list[float] | None) -> bool:
    return (
        before is not None and after is not None and any(abs(a - b) > 0.1 for a, b in zip(before, after, strict=True))
    )
