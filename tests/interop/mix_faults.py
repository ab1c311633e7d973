"""What clients see while a part of the way to ROS 1's move_base fails, and a stop is asked for meanwhile.

The measure is the base's own program (`tests/support/ros1_base.py`), which goes on whatever becomes of move_base: it
tells whether the robot moves. No client may be told that the robot stands while it moves.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tests.interop.mix_clients import SECONDS, SILENT, Client, RosClient
from tests.support.process import Process, stands_still
from tests.support.ros1 import ROS1_PYTHON
from tests.support.wait import until

if TYPE_CHECKING:
    from tests.interop.mix_table import Mix

AWAY = 800.0
"""Metres along x: so far that no drive of these comes there."""

STOP_AFTER = 0.5
"""Seconds after the fault at which a stop is asked for."""

UNTRUE_SECONDS = 2.0
"""A client that is told for longer, on a busy machine, that the robot stands while it moves, has been told a lie."""

UNCONFIRMED = "may still be moving"
"""What each stop is answered that is not confirmed."""

_ENDS = {"idle", "goal_reached", "succeeded", "canceled", "aborted", "error", "failing"}
"""What clients take for the end."""

_LOOK = 0.05


class Base:
    """The robot's base: whether it moves, by its own word.

    Args:
        env: where ROS's master is.
    """

    def __init__(self, env: Mapping[str, str]) -> None:
        self._process = Process([ROS1_PYTHON, Path(__file__).parents[1] / "support" / "ros1_base.py"], env)
        self.stop = self._process.stop

    def changes(self, since: float = 0.0) -> list[tuple[bool, float]]:
        """Whether it moved from then on, and when that began (monotonic), oldest first."""
        rows = [line.split() for line in self._process.output().splitlines(keepends=True) if line.endswith("\n")]
        told = [(row[0] == "moves", float(row[1])) for row in rows if row[:1] in (["moves"], ["stands"])]
        return [one for one in told if one[1] >= since]

    @property
    def moves(self) -> bool:
        """Whether it moves now."""
        changes = self.changes()
        return bool(changes) and changes[-1][0]


@dataclass(frozen=True)
class Fault:
    """What fails.

    Attributes:
        begin: makes it.
        end: mends it, where the daemon does not.
        client_dies: whether a goal of move_base's own client is lost by it.
        gateway_dies: whether there is nobody to answer for a while.
    """

    begin: Callable[[Mix], None]
    end: Callable[[Mix], None] = lambda _mix: None
    client_dies: bool = False
    gateway_dies: bool = False


def _kill(mix: Mix) -> None:
    mix.planner.signal(signal.SIGKILL)
    mix.planner.popen.wait()


def _hang(mix: Mix) -> None:
    mix.planner.signal(signal.SIGSTOP)
    until(lambda: stands_still(mix.planner.pid), "the planner hangs")


FAULTS = {
    "planner dies": Fault(_kill, lambda mix: mix.restart(), client_dies=True),
    "planner hangs": Fault(_hang, lambda mix: mix.planner.signal(signal.SIGCONT)),
    "ros1 worker dies": Fault(lambda mix: os.kill(mix.pid("ros1"), signal.SIGKILL)),
    "modules die": Fault(lambda mix: os.kill(mix.pid("gateway"), signal.SIGKILL), gateway_dies=True),
}


@dataclass
class Watch:
    """Follows what a client and everybody are told, beside what the base does. Times are seconds after the fault.

    Attributes:
        told: what was told, and when.
        untrue: for how long at most the robot was said to stand while it moved.
        answer: to the stop, and after how long.
    """

    mix: Mix
    client: Client
    began: float = field(default_factory=time.monotonic)
    told: list[tuple[float, str]] = field(default_factory=list)
    untrue: float = 0.0
    answer: tuple[float, str] | None = None
    _since: float | None = None

    def look(self) -> None:
        """Note what is told now."""
        moved = self.mix.base.moves
        seen, (state, reason) = self.client.seen(), self.mix.said()
        if seen == "aborted" and UNCONFIRMED in (self.client.why() or reason):
            seen = "aborted, and may still be moving"
        now = time.monotonic()
        said = f"{seen} | {state}: {reason}" if reason else f"{seen} | {state}"
        if not self.told or self.told[-1][1] != said:
            self.told.append((now - self.began, said))
        if not (moved and self.mix.base.moves and {seen, state} & _ENDS):
            self._since = None
            return
        self._since = now if self._since is None else self._since
        self.untrue = max(self.untrue, now - self._since)
        assert self.untrue < UNTRUE_SECONDS, f"it is said to stand ({said}), and moves"

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Look on until something is so."""

        def so() -> object:
            self.look()
            return condition()

        try:
            until(so, what, SECONDS, _LOOK)
        except AssertionError as err:
            raise AssertionError(f"{err}; {self}") from None

    def __str__(self) -> str:
        changes = [(moves, at - self.began) for moves, at in self.mix.base.changes(self.began)]
        base = ", ".join(f"{'moves' if moves else 'stands'} {at:.1f}" for moves, at in changes)
        words = [f"base: {base}", f"untrue for {self.untrue:.1f} s"]
        if self.answer is not None:
            words.append(f"stop at {STOP_AFTER:g} s answered after {self.answer[0]:.1f} s: {self.answer[1] or 'ok'}")
        return "; ".join([*words, *(f"{at:.1f} s: {said}" for at, said in self.told)])


def attempt(mix: Mix, fault: Fault, client: Client, watches: list[Watch], *, own: bool) -> str:
    """One client's drive, with a fault in it; the mark. What the client saw is added to ``watches``."""
    client.goto(AWAY)

    def drives() -> object:
        if client.end() == "canceled":
            client.goto(AWAY)  # the last stop was of all goals, and reached a planner that was away only now
        return mix.base.moves and mix.said()[0] == "moving" and client.progress()

    Watch(mix, client).until(drives, "it moves")
    watch = Watch(mix, client)
    watches.append(watch)
    fault.begin(mix)
    watch.until(lambda: time.monotonic() > watch.began + STOP_AFTER, "it fails for a while")
    (_own if own else _stop)(watch, fault)
    watch.until(mix.back, "everything is back")
    watch.until(lambda: not mix.driving() and mix.said()[0] in ("idle", "aborted"), "nothing drives")
    watch.until(lambda: not mix.base.moves, "it stands")
    if not own and isinstance(client, RosClient):
        assert client.ends() == 1, f"its goal had {client.ends()} ends"
    if fault.gateway_dies:
        client.goto(AWAY)
        until(lambda: mix.base.moves, "it drives again", SECONDS)
        client.cancel()
        until(lambda: client.end() == "canceled" and not mix.base.moves, "it stands again", SECONDS)
    return "own" if own else "yes"


def _stop(watch: Watch, fault: Fault) -> None:
    """A stop is asked for at once; the fault ends after its answer."""
    asked, began = watch.client.stop(), time.monotonic()
    watch.until(lambda: asked() is not None, "the stop is answered")
    answer = asked() or ""
    watch.answer = time.monotonic() - began, answer
    if not answer:
        assert not watch.mix.base.moves, "a stop is answered ok, and it moves"
    elif answer != "not ok":  # YARP has no words
        assert UNCONFIRMED in answer or (fault.gateway_dies and SILENT in answer), answer
    fault.end(watch.mix)
    watch.until(watch.client.end, "its goal has an end")


def _own(watch: Watch, fault: Fault) -> None:
    """A client of move_base itself sees what it would without Midspan."""
    assert watch.client.end() == "", "its goal ended"
    fault.end(watch.mix)
    if fault.client_dies:
        assert watch.client.end() != "succeeded", "its goal ended"
        return
    watch.until(watch.mix.back, "everything is back")
    watch.client.cancel()
    watch.until(lambda: watch.client.end() == "canceled", "its goal is cancelled")
