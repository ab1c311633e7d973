"""One run of the demo: starts the real programs and the daemon, drives, checks what was bridged, ends everything."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import Any, Self

from bridge.demo.progress import DemoRun
from bridge.demo.rospy_packages import program_environment
from bridge.demo.sandbox import Sandbox
from bridge.demo.shutdown import Shutdown, end_all
from bridge.demo.topics_demo import messages
from bridge.demo.topics_demo.checks import ROS1, ROS2, YARP, YARP_TEXT, ZENOH, CrossingCheck, Drive, evaluate

PROGRAMS = (ROS1, ROS2, ZENOH, YARP)

SHOW_SECONDS = 20.0
"""Minimum duration of a run, so that a person sees the table change."""

ASK_AGAIN = 1.5
"""Seconds after which the zenoh program, as a late subscriber, subscribes again to topics that it has not received."""

LATE_SECONDS = 5.0
"""Maximum seconds for which each late subscriber waits for earlier messages."""

CROSS_SECONDS = 10.0
"""Seconds to wait for missing messages at the end, once no more messages arrive."""

SILENCE = 2.0
"""Seconds after a drive; by then the command has timed out (0.5 s), and the robot has braked (1 s)."""

Tick = Callable[[str], None]
"""Called several times a second with the current activity."""


@dataclass
class TopicsResult:
    """The results of a run."""

    checks: list[CrossingCheck] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether everything was bridged as expected."""
        return bool(self.checks) and all(check.ok for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """Return the content of the demo's JSON file."""
        return {"ok": self.ok, "seconds": round(self.seconds, 1), "checks": [check.as_dict() for check in self.checks]}


class TopicsDemo(DemoRun):
    """One run of the demo, a context manager; calls ``tick`` while it waits."""

    def __init__(self, sandbox: Sandbox, tick: Tick, shutdown: Shutdown) -> None:
        super().__init__(sandbox, shutdown)
        self._tick = tick
        self._drives: list[Drive] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.stop()

    def run(self, seconds: float = SHOW_SECONDS) -> TopicsResult:
        """Start, drive and check, for at least ``seconds``; raises `DemoError` if a part does not start."""
        self._start()
        self._wait_until_joined()
        for program in (ROS2, ZENOH, YARP):
            self._join_late(program)
        self._drive(ROS2, 0.3, 0.0, 2.5)
        self._drive(ZENOH, 0.0, 0.8, 2.0)
        self._drive(YARP, -0.3, 0.0, 2.0)
        self._drive(YARP_TEXT, 0.0, -0.8, 1.5)
        self._progress.begin()
        while not (result := self.result()).ok and self._progress.still < CROSS_SECONDS:
            self._wait(0.25, "waiting for missing messages", watch=False)
            for check in result.checks:
                if not check.ok:
                    self._progress.note(check.name, f"{check.target} {check.topic} {check.seen}", numbers=True)
        self._wait(seconds - (time.monotonic() - self._began), "the programs keep receiving")
        return self.result()

    def result(self) -> TopicsResult:
        """Return the current results."""
        reports = {name: self._children[name].report for name in PROGRAMS}
        return TopicsResult(evaluate(reports, self._drives), time.monotonic() - self._began)

    def stay(self) -> None:
        """Continue until interrupted, or until a part ends."""
        while True:
            self._wait(0.5, "staying; Ctrl-C ends the demo")

    def _start(self) -> None:
        sandbox = self._sandbox
        environment = sandbox.environment()
        self._launch_roscore_and_daemon()
        self._launch_program(ROS2, "ros2_program", environment)
        self._launch_program(YARP, "yarp_program", environment, sandbox.yarp_port)
        self._wait_for(sandbox.master_answers, "the ROS 1 master")
        ros1 = program_environment(sandbox.config, environment, sandbox.folder / "packages")
        self._launch_program(ROS1, "robot", ros1)
        self._wait_for(lambda: self._parts.up("router"), "the hub's router")  # the SDK requires it
        self._launch_program(ZENOH, "zenoh_program", environment, sandbox.router_port, sandbox.config.hub.domain)
        for program in PROGRAMS:
            self._wait_for(partial(self._children[program].has_event, "ready"), program)

    def _launch_program(self, who: str, module: str, env: Mapping[str, str], *arguments: int) -> None:
        self._launch(who, [sys.executable, "-m", f"bridge.demo.topics_demo.{module}", *map(str, arguments)], env)

    def _wait_for(self, ready: Callable[[], bool], what: str) -> None:
        """Wait for a part while there is progress; raises `DemoError` without progress, or if a part failed."""
        self._progress.begin()
        while not ready():
            silent = [child for name, child in self._children.items() if name in PROGRAMS and not child.report]
            self._parts.starting = [child.pid for child in silent]
            self._wait(0.1, f"starting {what}")
            self._check(what)

    def _wait_until_joined(self) -> None:
        """Wait until each program has received something from the robot; the checks report what is missing."""
        listeners = [self._children[program] for program in (ROS2, ZENOH, YARP)]
        self._until(
            lambda: all(_received_anything(child.report) for child in listeners),
            0.2,
            "waiting for the first bridged messages",
        )

    def _join_late(self, program: str) -> None:
        """Let a program subscribe to earlier messages, and wait a moment for them.

        zenoh-ros2-sdk queries latched messages only once; on a busy machine this may be before it has discovered the
        publishers. Its program therefore comes second, and subscribes again.
        """
        child, end, retry = self._children[program], time.monotonic() + LATE_SECONDS, 0.0
        while time.monotonic() < end:
            if not retry or (program == ZENOH and time.monotonic() > retry):
                child.ask("join_late")
                retry = time.monotonic() + ASK_AGAIN
            topics = child.report.get("heard", {})
            if all(topics.get(topic, {}).get("count") for topic in (messages.MAP, messages.TF_STATIC)):
                return
            self._wait(0.1, f"{program} joins late")

    def _drive(self, source: str, linear: float, angular: float, seconds: float) -> None:
        text = source == YARP_TEXT
        program, more = (YARP, {"text": True}) if text else (source, {})
        robot, driver = self._children[ROS1], self._children[program]
        before, received = robot.report.get("pose", [0.0] * 3), _received(robot.report)
        driver.ask("drive", linear=linear, angular=angular, seconds=seconds, **more)
        self._until(lambda: driver.has_event("drove"), 0.1, f"{source} drives the robot")
        drove = driver.wait_for("drove", 0.0) or {}
        self._wait(SILENCE, "the driver is silent")
        silent = time.monotonic()
        self._until(lambda: robot.report.get("time", 0.0) > silent, 0.05, "the driver is silent")
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

    def _until(self, ready: Callable[[], bool], every: float, doing: str) -> None:
        """Wait for a condition while there is progress; the checks report what is missing."""
        self._progress.begin()
        while not ready() and not self._progress.stalled:
            self._wait(every, doing)

    def _wait(self, seconds: float, doing: str, *, watch: bool = True) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._show(doing, watch=watch)
            time.sleep(min(left, 0.2))

    def _show(self, doing: str, *, watch: bool) -> None:
        self._check_processes()
        if watch:
            self._parts.refresh(self._progress)
            self._watch_the_robot()
        self._tick(doing)

    def _watch_the_robot(self) -> None:
        report = self._children[ROS1].report if ROS1 in self._children else {}
        if report:
            x, y, yaw = report.get("pose", [0.0] * 3)
            self._progress.note_pose(x, y, yaw)
            self._progress.note("the robot", f"commands: {_received(report)}", numbers=True)

    def stop(self) -> None:
        """End all processes, dependent ones first."""
        groups = (((ZENOH, ROS2, ROS1, YARP), 4.0), (("daemon",), 9.0), (("roscore",), 9.0))
        children = self._children
        stages = [([children[name] for name in names if name in children], seconds) for names, seconds in groups]
        end_all(self._sandbox, self._shutdown, stages)


def _received_anything(report: dict[str, Any]) -> bool:
    topics = report.get("heard", {})
    return any(topics.get(topic, {}).get("count") for topic in (messages.ODOM, messages.TF, messages.SCAN))


def _received(report: dict[str, Any]) -> int:
    count: int = report.get("heard", {}).get(messages.CMD_VEL, {}).get("count", 0)
    return count


def _moved(before: list[float] | None, after: list[float] | None) -> bool:
    return (
        before is not None and after is not None and any(abs(a - b) > 0.1 for a, b in zip(before, after, strict=True))
    )
