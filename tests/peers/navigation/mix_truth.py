"""The robot's real motion, as measured by its base's program, and checks of reported states against it."""

from __future__ import annotations

import itertools
import math
import signal
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from tests.peers.ros1.network import ROS1_PYTHON
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.process import Process

PEERS = Path(__file__).parents[1]

UNTRUE_SECONDS = 0.5
"""Seconds within which the base must stand after a reported end. A planner reports the end of its goal and zero
velocity on different connections. A reply "ok" to a stop or a pause has no such allowance."""

JERK_SECONDS = 0.3
"""Seconds; a planner that wakes up may send one more velocity before it receives a stop that is already confirmed."""

ENDS = {"idle", "goal_reached", "succeeded", "canceled", "aborted", "paused", "error", "failing"}
"""States in which the robot is not expected to move."""

PREPARING = "preparing_before_move"

Word = tuple[float, str]
"""A received state: the time (monotonic) and the text."""


class Base:
    """The program of a robot's base.

    Args:
        args: the program's interpreter, file and options.
        env: the environment of the base's side.
    """

    def __init__(self, args: Sequence[str | Path], env: Mapping[str, str]) -> None:
        self._process = Process(args, env)
        self._last: str | None = None

    @classmethod
    def ros1(cls, env: Mapping[str, str], *options: str) -> Self:
        """Return a base on ROS 1."""
        return cls([ROS1_PYTHON, PEERS / "ros1" / "base.py", *options], env)

    @classmethod
    def ros2(cls, *options: str) -> Self:
        """Return a base on ROS 2."""
        return cls([ros2_python(), PEERS / "ros2" / "base.py", *options], ros2_environment())

    def changes(self, since: float = 0.0) -> list[tuple[bool, float]]:
        """Return the changes since a time, oldest first: whether the base moves, and when that began (monotonic)."""
        output = self._process.output() if self._last is None else self._last
        rows = [line.split() for line in output.splitlines(keepends=True) if line.endswith("\n")]
        changes = [(row[0] == "moves", float(row[1])) for row in rows if row[:1] in (["moves"], ["stands"])]
        return [change for change in changes if change[1] >= since]

    def stop(self, seconds: float = 6.0) -> None:
        """Stop the program; from then on, the base counts as standing."""
        if self._last is None:
            self._last = f"{self._process.output()}stands {time.monotonic()} 0\n"
            self._process.stop(seconds)

    @property
    def moves(self) -> bool:
        """Return whether the base moves now."""
        return self.moved_at(math.inf)

    def moved_at(self, at: float) -> bool:
        """Return whether the base moved at a time."""
        before = [moves for moves, since in self.changes() if since <= at]
        return bool(before) and before[-1]

    def stands_after(self, at: float) -> float:
        """Return when the base first stood after a time; infinity if it has moved since then."""
        if not self.moved_at(at):
            return at
        return next((since for moves, since in self.changes(at) if not moves), math.inf)

    def moved(self, begin: float, end: float) -> float:
        """Return for how many seconds the base moved in an interval."""
        times = [begin, *(since for _, since in self.changes() if begin < since < end), end]
        spans = itertools.pairwise(times)
        return sum(after - before for before, after in spans if self.moved_at(before))


class Nav2:
    """The stand-ins for Nav2's servers, one process each, as in Nav2.

    Args:
        speed: the robot's speed, m/s.
        patience: seconds until an unreachable goal is aborted.
        navigator: further options of bt_navigator.
        controller: further options of controller_server.
        lease: environment variables that set the DDS lease, if it is not the default.
    """

    def __init__(
        self,
        speed: float,
        patience: float,
        *,
        navigator: Sequence[str] = (),
        controller: Sequence[str] = (),
        lease: Mapping[str, str] | None = None,
    ) -> None:
        self._env = {**ros2_environment(), **(lease or {})}
        servers = PEERS / "ros2" / "controller.py"
        self._commands: dict[str, list[str | Path]] = {
            "bt_navigator": [PEERS / "ros2" / "nav2.py", str(speed), str(patience), "--servers", *navigator],
            "controller_server": [servers, "controller_server", str(speed), *controller],
            "behavior_server": [servers, "behavior_server", str(speed)],
        }
        self.servers: dict[str, Process] = {}
        self.killed = False
        for name in self._commands:
            self.start(name)

    def start(self, name: str) -> None:
        """Start one of the servers, in place of one that was killed."""
        if name in self.servers:
            self.servers[name].stop(0)
        self.servers[name] = Process([ros2_python(), *self._commands[name]], self._env)

    def ready(self) -> bool:
        """Return whether all servers are up."""
        return all("ready" in server.output() for server in self.servers.values())

    def kill(self, name: str) -> None:
        """Kill one of the servers."""
        self.killed = True
        self.servers[name].signal(signal.SIGKILL)
        self.servers[name].popen.wait()

    def give_up(self) -> None:
        """Make bt_navigator abort its goal, as after a late acknowledgment, while controller_server keeps driving."""
        self.servers["bt_navigator"].signal(signal.SIGUSR1)

    def stop(self, seconds: float = 6.0) -> None:
        """Stop all servers."""
        for server in self.servers.values():
            server.signal(signal.SIGCONT)
            server.stop(seconds)


def untrue(words: Sequence[Word], base: Base, end: float) -> float:
    """Return the longest time that the robot still moved after it was reported to stand, up to ``end`` (monotonic).

    A reported end counts until the base stands, even if the report is withdrawn at once; `PREPARING` counts while it
    lasts.
    """
    worst = 0.0
    for (at, state), (until_, _) in itertools.pairwise([*words, (end, "")]):
        if state not in ENDS and state != PREPARING:
            continue
        began = [at, *(since for moves, since in base.changes(at) if moves and since < until_)]
        for start in began:
            stood = min(base.stands_after(start), end)
            stood = min(stood, until_) if state == PREPARING or start != at else stood
            worst = max(worst, stood - start)
    return worst


def released(output: str, since: float) -> float:
    """Return when a planner's stand-in first released a goal after ``since`` (monotonic); infinity if it has not."""
    rows = [line.split() for line in output.splitlines()]
    return min((float(row[1]) for row in rows if row[:1] == ["ended"] and float(row[1]) >= since), default=math.inf)


def stood(base: Base, at: float) -> str:
    """Return why a reply "ok" at a time was wrong, or "" if it was right."""
    if not base.moved_at(at):
        return ""
    later = base.stands_after(at)
    return f"the base moved, and stood {later - at:.2f} s later" if math.isfinite(later) else "the base keeps moving"
