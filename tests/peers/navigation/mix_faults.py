"""The reports that clients receive while a part of the path to the planner fails and stops are requested.

They are checked against the base's own program (`tests.peers.navigation.mix_truth`): while the planner moves the base,
no client may receive "ok" to a stop, or a state that means an end.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from tests.peers.navigation.mix import MOVE_BASE, NAV2, Mix
from tests.peers.navigation.mix_clients import ROS1, ROS2, SECONDS, SILENT, YARP, ZENOH, Client, RosClient, ZenohClient
from tests.peers.navigation.mix_truth import JERK_SECONDS, UNTRUE_SECONDS, Word, stood, untrue
from tests.support.process import is_stopped
from tests.support.wait import until

AWAY = 800.0
"""Meters along x, farther than any drive of these tests."""

STANDS_SECONDS = 9.0
"""Seconds within which the base stands after a stop that is sent while the planner can be reached."""

LOST_SECONDS = 8.0
"""Seconds after which a reply that has not arrived was lost with the gateway."""

STOP_AFTER = 0.5
"""Seconds after a fault at which a stop is requested."""

UNCONFIRMED = "may still be moving"
"""Part of the reply to each unconfirmed stop."""

MAY_MOVE = "aborted, and may still be moving"
"""A reported end that does not claim that the robot stands."""

UNOBSERVED = ""
"""The state between two polls, the second of which returned another state than the first."""

_POLL = 0.05


@dataclass(frozen=True)
class Fault:
    """A fault, and how clients react to it.

    Attributes:
        begin: causes the fault.
        end: repairs the fault, if the daemon does not.
        planner: the planner in use.
        stop_after: seconds until a stop is requested.
        client_dies: whether the planner's own client loses its goal.
        gateway_dies: whether calls fail for a while.
        stopped: whether all clients request a stop, even for a goal of the planner's own client. Otherwise only the
            goal's client requests one, and the planner's own client cancels its goal later.
        clients: the clients that `make mix` tests the fault with.
    """

    begin: Callable[[Mix], None]
    end: Callable[[Mix], None] = lambda _mix: None
    planner: str = MOVE_BASE
    stop_after: float = STOP_AFTER
    client_dies: bool = False
    gateway_dies: bool = False
    stopped: bool = False
    clients: tuple[str, ...] = (YARP, ROS1, ROS2, ZENOH)


def _kill(mix: Mix) -> None:
    mix.planner.signal(signal.SIGKILL)
    mix.planner.popen.wait()


def _hang(mix: Mix) -> None:
    mix.planner.signal(signal.SIGSTOP)
    until(lambda: is_stopped(mix.planner.pid), "the planner hangs")


def kill_workers(*workers: str) -> Callable[[Mix], None]:
    """Return a `Fault.begin` that kills several of the daemon's workers at once."""

    def kill(mix: Mix) -> None:
        for pid in [mix.pid(worker) for worker in workers]:
            os.kill(pid, signal.SIGKILL)

    return kill


FAULTS = {
    "planner dies": Fault(_kill, lambda mix: mix.restart(), client_dies=True),
    "planner hangs": Fault(_hang, lambda mix: mix.planner.signal(signal.SIGCONT)),
    "ros1 worker dies": Fault(kill_workers("ros1")),
    "modules die": Fault(kill_workers("gateway"), gateway_dies=True),
    "master dies": Fault(
        lambda mix: mix.kill_master(), lambda mix: mix.restart_ros1(), stopped=True, clients=(ROS1, ZENOH)
    ),
    "ros1 and modules die": Fault(
        kill_workers("ros1", "gateway"), gateway_dies=True, stopped=True, clients=(YARP, ROS1)
    ),
    "bt_navigator gives up": Fault(
        lambda mix: mix.planner.give_up(),
        planner=NAV2,
        stop_after=1.0,
        client_dies=True,
        stopped=True,
        clients=(YARP, ROS2),
    ),
    "bt_navigator dies": Fault(
        lambda mix: mix.planner.kill("bt_navigator"),
        lambda mix: mix.restart_navigator(),
        planner=NAV2,
        client_dies=True,
        stopped=True,
        clients=(YARP, ROS2),
    ),
}


@dataclass
class Watch:
    """Follows what clients receive and what the base does. Times are seconds after the fault.

    Attributes:
        client: the goal's client; "" for a goal that no client of the mix follows.
        own: whether this is the planner's own client, so that the planner itself reports the end of the goal.
        words: the states that each client received, in order.
        texts: the gateway's states with their reasons, for people.
        answers: the replies to stops, by client: the time, and "" or the reason.
        allowance: seconds that the base may move after a reported end.
    """

    mix: Mix
    client: str
    own: bool = False
    allowance: float = UNTRUE_SECONDS
    began: float = field(default_factory=time.monotonic)
    words: dict[str, list[Word]] = field(default_factory=dict)
    texts: list[Word] = field(default_factory=list)
    answers: dict[str, tuple[float, str]] = field(default_factory=dict)
    untrue: float = 0.0
    trouble: list[str] = field(default_factory=list)
    _read: int = 0
    _asked: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.base = self.mix.base
        self._read = len(self.mix.statuses)
        if self._read:
            self._note("status", self.began, self.mix.status()[0])

    def poll(self) -> None:
        """Record what clients have received since the last call."""
        for at, status in self.mix.statuses[self._read :]:
            self._read += 1
            state, reason = str(status["state"]), str(status["reason"])
            if state == "aborted" and UNCONFIRMED in reason:
                state = MAY_MOVE
            self._note("status", at, state, f"{state}: {reason}" if reason else state)
        self._note(YARP, 0.0, self.mix.clients[YARP].seen())
        if self.client in ("", YARP) or self.own:
            return
        client = self.mix.clients[self.client]
        end = client.end()
        if end == "aborted" and UNCONFIRMED in (client.why() or ""):
            end = MAY_MOVE
        self._note(self.client, client.ended_at() if end else 0.0, end or client.seen())

    def _note(self, who: str, at: float, word: str, text: str = "") -> None:
        words, now = self.words.setdefault(who, []), time.monotonic()
        if who == "status":
            self.texts.append((at or now, text or word))
        if not words or words[-1][1] != word:
            if words and not at:  # on a busy machine, this poll may be late
                words.append((max(self._asked[who], self.began), UNOBSERVED))
            words.append((max(at or now, self.began), word))
        self._asked[who] = now

    def until(self, condition: Callable[[], object], what: str, seconds: float = SECONDS) -> None:
        """Poll until a condition holds."""

        def holds() -> object:
            self.poll()
            return condition()

        try:
            until(holds, what, seconds, _POLL)
        except AssertionError as err:
            raise AssertionError(f"{err}; {self}") from None

    def ask(self, word: str, clients: Sequence[str], *, lost: bool = False) -> None:
        """Let clients request a stop, a pause or a resume, all at once, and return when all have their replies.

        With ``lost``, a reply may be lost with the gateway; rclpy's client would wait for it forever.
        """
        calls = {name: self.mix.callers[name].ask(word) for name in clients}
        end = time.monotonic() + LOST_SECONDS

        def answered() -> bool:
            return all(answer() is not None for answer in calls.values()) or (lost and time.monotonic() > end)

        self.until(answered, f"every {word} is answered")
        self.answers = {name: answer() or (time.monotonic(), SILENT) for name, answer in calls.items()}
        if word == "resume":
            return
        for name, (at, answer) in self.answers.items():
            wrong = stood(self.base, at) if not answer else ""
            if wrong:
                self.trouble.append(f"{name} received ok to a {word}: {wrong}")

    def close(self) -> None:
        """Compare the received states with the base's motion; raise `AssertionError` if they differ."""
        end = time.monotonic()
        for client, states in self.words.items():
            seconds = untrue([entry for entry in states if entry[1] != SILENT], self.base, end)
            self.untrue = max(self.untrue, seconds)
            if seconds > self.allowance:
                self.trouble.append(f"{client} received that the robot stands while it moved for {seconds:.2f} s")
        for name, (at, answer) in self.answers.items():
            moved = 0.0 if answer else self.base.moved(at, end)
            if moved > JERK_SECONDS and not stood(self.base, at):
                self.trouble.append(f"{name} received ok, and the base moved for {moved:.2f} s after it")
        self.trouble = list(dict.fromkeys(self.trouble))
        assert not self.trouble, f"{'; '.join(self.trouble)}; {self}"

    def __str__(self) -> str:
        changes = [(moves, at - self.began) for moves, at in self.base.changes(self.began)]
        base = ", ".join(f"{'moves' if moves else 'stands'} {at:.1f}" for moves, at in changes)
        parts = [f"base: {base}", f"untrue for {self.untrue:.2f} s"]
        for name, (at, answer) in self.answers.items():
            parts.append(f"{name} answered at {at - self.began:.1f}: {answer or 'ok'}")
        for client, states in {**self.words, "status": self.texts}.items():
            parts.append(f"{client}: {', '.join(f'{at - self.began:.2f} {state}' for at, state in states)}")
        return "; ".join(parts)


def start_driving(mix: Mix, client: Client, progress: int = 5) -> None:
    """Send a client's goal, and wait until the base moves and ``progress`` reports of progress have arrived."""
    client.goto(AWAY)

    def drives() -> object:
        if client.end() == "canceled":
            client.goto(AWAY)  # the last stop applied to all goals, and only now reaches a planner that was unreachable
        return mix.base.moves and mix.state() == "moving" and client.progress() >= progress

    until(drives, "the base moves", SECONDS, _POLL)


def attempt(mix: Mix, fault: Fault, name: str, watches: list[Watch], *, own: bool) -> str:
    """Let one client drive until a fault, append the watch to ``watches``, and return the mark."""
    client = mix.clients[name]
    start_driving(mix, client)
    watch = Watch(mix, name, own=own)
    watches.append(watch)
    fault.begin(mix)
    watch.until(lambda: time.monotonic() > watch.began + fault.stop_after, "the fault lasts for a while")
    if own and not fault.stopped:
        _check_own(watch, client, fault)
    else:
        _stop(watch, client, fault)
    watch.until(mix.back, "all workers are back")
    watch.until(lambda: not mix.driving() and mix.state() in ("idle", "aborted"), "no goal is active")
    watch.until(lambda: not mix.base.moves, "the base stands")
    watch.close()
    if not own and isinstance(client, RosClient | ZenohClient):
        assert client.ends() == 1, f"the client's goal had {client.ends()} ends"
    if fault.gateway_dies or fault.stopped:
        _again(mix, client)
    return "own" if own else "yes"


def _again(mix: Mix, client: Client) -> None:
    """Drive and cancel, as without a fault."""
    client.goto(AWAY)
    until(lambda: mix.base.moves, "the base moves again", SECONDS)
    client.cancel()
    until(lambda: client.end() == "canceled" and not mix.base.moves, "the base stands again", SECONDS)


def _stop(watch: Watch, client: Client, fault: Fault) -> None:
    """Request stops at once; end the fault after their replies."""
    callers = (
        (YARP, ROS2, ZENOH) if fault.planner == MOVE_BASE else (YARP, ROS1, ROS2, ZENOH)
    )  # clients that can reach the gateway's services during the fault
    watch.ask("stop", callers if fault.stopped else [watch.client], lost=fault.gateway_dies)
    for name, (_, answer) in watch.answers.items():
        if answer and answer != "not ok":  # YARP's reply has no text
            assert UNCONFIRMED in answer or (fault.gateway_dies and SILENT in answer), f"{name}: {answer}"
    if fault.stopped:
        if all(SILENT in answer for _, answer in watch.answers.values()):  # each request was lost with the gateway
            watch.until(watch.mix.back, "all workers are back")
            watch.ask("stop", callers)
        if fault.gateway_dies:  # on a busy machine, a restart takes longer than a stop
            watch.until(watch.mix.back, "all workers are back")
        watch.until(lambda: not watch.base.moves, "the stop reaches the planner", STANDS_SECONDS)
    fault.end(watch.mix)
    if not watch.own:
        watch.until(client.end, "the client's goal has ended")


def _check_own(watch: Watch, client: Client, fault: Fault) -> None:
    """Check that a client of the planner itself observes the same as without Midspan."""
    assert client.end() == "", "the client's goal ended"
    fault.end(watch.mix)
    if fault.client_dies:
        assert client.end() != "succeeded", "the client's goal succeeded"
        return
    watch.until(watch.mix.back, "all workers are back")
    client.cancel()
    watch.until(lambda: client.end() == "canceled", "the client's goal is canceled")
