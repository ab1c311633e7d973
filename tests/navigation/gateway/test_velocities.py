"""Velocities of YARP clients: repeated while they last, then zero for a moment, unless a planner drives."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.client.velocity import STOP_SECONDS
from bridge.hub.errors import HubClosedError
from bridge.modules.background import Background
from navigation.gateway import velocities
from navigation.gateway.choice import RequestError
from navigation.gateway.stop import OVERRIDE_SECONDS
from navigation.gateway.velocities import VelocityCommander, YarpVelocity
from tests.peers.navigation.simulated_hub import Clock, Loop

DRIVE = YarpVelocity(0.3, 0.0, 0.0)
ZEROS = round(STOP_SECONDS / velocities._PERIOD)


class Base:
    """A commander on a simulated clock, and the velocities that it publishes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self._monkeypatch, self._folder = monkeypatch, folder
        self.clock, self.received, self.busy = Clock(), list[float](), False
        self.loop = Loop(self.clock)
        self.fails = False  # whether publishing fails
        publisher = SimpleNamespace(publish=self._publish)
        monkeypatch.setattr(velocities, "velocity_publisher", lambda *_: publisher)
        monkeypatch.setattr(velocities, "time", self.clock)
        self.drivers = dict[str, str]()  # other persons by zid; that of the gateway is "5"
        self.announced: str | None = None
        graph = SimpleNamespace(drivers=lambda _topic: self.drivers)
        hub = SimpleNamespace(graph=graph, zid="5", announce_driver=self._announce)
        background = Background(self.loop, "gateway", inline=True)  # type: ignore[arg-type]
        host: Any = SimpleNamespace(
            loop=self.loop, name="gateway", node=SimpleNamespace(hub=hub), log=logging.getLogger("gateway"),
            folder=folder, background=background,
        )  # fmt: skip
        self.commander = VelocityCommander(host, "/cmd_vel", lambda: self.busy)

    def _publish(self, x: float, _y: float, _turn: float) -> None:
        if self.fails:
            raise HubClosedError("this node of the hub is closed")
        self.received.append(x)

    def _announce(self, _topic: str, who: str) -> Callable[[], None]:
        self.announced = who
        return lambda: setattr(self, "announced", None)

    def restarted(self, *, ended: bool) -> Base:
        """Return the gateway's next run; this one ends in order, or crashes."""
        if ended:
            self.commander.end(lambda: None)
        return Base(self._monkeypatch, self._folder)

    def after(self, seconds: float) -> list[float]:
        """Return the velocities of the next seconds."""
        begin = len(self.received)
        self.clock.run_to(self.clock.now + seconds)
        return self.received[begin:]


def logged(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return the commander's messages, without those of other threads."""
    return [record.getMessage() for record in caplog.records if record.name == "gateway"]


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Base:
    return Base(monkeypatch, tmp_path)


@pytest.mark.parametrize("stopped", [False, True], ids=["it expires", "it is stopped"])
def test_zero_is_repeated_after_a_velocity_and_then_nothing_is_published(base: Base, stopped: bool) -> None:
    base.commander.command(DRIVE, 0.2)
    if stopped:
        base.commander.stop()
        assert base.commander.last is None
    base.after(5.0)
    assert base.received.count(0.0) == ZEROS
    assert base.received[-ZEROS:] == [0.0] * ZEROS


def test_a_clients_own_zero_is_repeated(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.commander.command(YarpVelocity(), 0.0)
    base.after(5.0)
    assert base.received == [0.3, *[0.0] * ZEROS]


def test_zeros_are_counted_while_the_process_stalls(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.loop.stall(2 * STOP_SECONDS)
    base.after(5.0)
    assert base.received == [0.3, *[0.0] * ZEROS]


def test_a_planner_that_starts_ends_the_zeros(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.busy = True
    base.commander.stop()
    assert base.after(5.0) == []
    assert base.received == [0.3, 0.0]


def test_the_end_waits_for_the_last_zero(base: Base) -> None:
    ended: list[bool] = []
    base.commander.command(DRIVE, 0.2)
    base.commander.end(lambda: ended.append(True))
    base.after(STOP_SECONDS / 2)
    assert not ended
    base.after(5.0)
    assert ended == [True]
    base.commander.end(lambda: ended.append(False))
    assert ended == [True, False], "without a command it ends at once"


def test_a_client_that_repeats_its_velocity_does_not_delay_the_end(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.commander.end(lambda: None)
    with pytest.raises(RequestError, match="shutting down"):
        base.commander.command(DRIVE, 0.2)
    base.after(5.0)
    assert base.received == [0.3, *[0.0] * ZEROS]


def test_others_see_that_a_client_drives(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    assert base.announced == "a YARP client (gateway)"
    base.after(0.4)
    assert base.received[-1] == 0.0
    assert base.announced is None
    base.commander.command(DRIVE, 0.2)
    base.commander.command(YarpVelocity(), 0.2)
    assert base.announced is None
    base.commander.command(DRIVE, 0.2)
    base.commander.halt()
    assert base.announced is None


def test_a_command_is_refused_while_a_person_drives_manually(base: Base, caplog: pytest.LogCaptureFixture) -> None:
    base.drivers["7"] = "anna (web)"
    for _ in range(3):
        with pytest.raises(RequestError, match=r"anna \(web\) drives manually"):
            base.commander.command(DRIVE, 0.2)
    assert logged(caplog) == ["a velocity of a YARP client is refused: anna (web) drives manually"]
    assert (base.after(1.0), base.announced) == ([], None)
    base.drivers.clear()
    base.commander.command(DRIVE, 0.2)
    assert base.received == [0.3]


@pytest.mark.parametrize(("zid", "yields"), [("1", True), ("7", False)])
def test_of_two_that_begin_at_once_the_one_with_the_lower_zid_drives(base: Base, zid: str, yields: bool) -> None:
    base.commander.command(DRIVE, 0.2)
    base.drivers[zid] = "anna (web)"
    driven = base.after(0.15)
    assert driven == ([0.0] if yields else [0.3] * len(driven))
    assert (base.announced is None) is yields
    assert base.after(5.0).count(0.0) == (0 if yields else 1), "zeros would slow the person"


def test_a_command_that_cannot_be_published_ends_with_its_time(base: Base) -> None:
    base.fails = True
    with pytest.raises(HubClosedError):
        base.commander.command(DRIVE, 0.2)
    base.fails = False
    base.after(5.0)
    assert (base.announced, base.commander.last) == (None, None)
    assert base.received[-ZEROS:] == [0.0] * ZEROS


def test_a_stop_that_cannot_be_published_lets_others_drive(base: Base, caplog: pytest.LogCaptureFixture) -> None:
    """It raises nothing, because its caller stops the goals, too."""
    base.commander.command(DRIVE, 1.0)
    base.fails = True
    base.commander.stop()
    assert "zero velocity could not be published" in caplog.text
    assert base.announced is None
    base.fails = False
    base.after(5.0)
    assert base.received[1:] == [0.0] * (ZEROS - 1), "the timer repeats zero"


def test_the_end_is_reported_although_the_stop_cannot_be_published(base: Base) -> None:
    ended: list[bool] = []
    base.commander.command(DRIVE, 1.0)
    base.fails = True
    base.commander.end(lambda: ended.append(True))
    base.fails = False
    base.after(5.0)
    assert ended == [True]


def test_a_stopped_client_drives_again_only_after_a_pause(base: Base, caplog: pytest.LogCaptureFixture) -> None:
    base.commander.command(DRIVE, 0.2)
    base.commander.stop_client()
    for seconds in (0.2, 0.2, 0.2, 0.2, 0.2, 1.0):
        base.after(0.1)
        with pytest.raises(RequestError, match="the robot was stopped; first send no velocity"):
            base.commander.command(DRIVE, seconds)
    assert (base.received.count(0.3), base.announced) == (1, None)
    assert len(logged(caplog)) == 1
    base.after(0.9)
    with pytest.raises(RequestError, match="the robot was stopped"):
        base.commander.command(DRIVE, 0.2)  # a client that drives on repeats its velocity before its time is over
    base.after(0.2)
    base.commander.command(YarpVelocity(), 0.2)  # zeros of a joystick count as a pause
    base.after(0.2)
    base.commander.command(DRIVE, 0.2)
    assert base.received[-1] == 0.3


def test_a_client_that_is_refused_because_the_planner_drives_does_not_pause(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.commander.stop_client()
    for _ in range(10):  # the planner has the base until the stop is confirmed
        base.after(0.1)
        with pytest.raises(RequestError):
            base.commander.command(DRIVE, 0.2, planner_drives=True)
    base.after(0.1)
    with pytest.raises(RequestError, match="the robot was stopped"):
        base.commander.command(DRIVE, 0.2)


@pytest.mark.parametrize("other", ["a person", "the planner"])
def test_a_client_is_displaced_between_two_of_its_messages(base: Base, other: str) -> None:
    """The other one may have finished before the client's next message arrives."""
    base.commander.command(DRIVE, 1.0)
    if other == "a person":
        base.drivers["1"] = "anna (web)"
        base.after(0.1)
        base.drivers.clear()
    else:
        base.commander.displace()
    base.after(0.1)
    with pytest.raises(RequestError, match="the planner or a person drove; first send no velocity"):
        base.commander.command(DRIVE, 1.0)
    assert base.received[-1] == 0.0
    base.after(1.3)
    base.commander.command(DRIVE, 1.0)
    assert base.received[-1] == 0.3


@pytest.mark.parametrize("end", ["stop", "its own zero", "its time", "nothing"])
def test_without_a_stop_of_a_person_a_client_may_drive_at_once(base: Base, end: str) -> None:
    base.commander.command(DRIVE, 0.2)
    if end == "stop":  # because the planner drove
        base.commander.stop()
    elif end == "its own zero":
        base.commander.command(YarpVelocity(), 0.2)
    elif end == "its time":
        base.after(0.25)
    base.commander.command(DRIVE, 0.2)
    assert base.received[-1] == 0.3


def test_a_client_that_did_not_drive_at_the_stop_may_drive_at_once(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.after(2.0)
    base.commander.stop_client()
    base.commander.command(DRIVE, 0.2)
    assert base.received[-1] == 0.3


def test_a_clients_zero_ends_when_a_person_drives(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.commander.command(YarpVelocity(), 1.0)
    base.after(0.1)
    base.drivers["7"] = "anna (web)"
    assert len(base.after(5.0)) <= 1


def test_the_zeros_of_a_halt_override_a_person(base: Base) -> None:
    base.commander.halt()
    base.drivers["7"] = "anna (web)"
    assert base.after(0.9 * OVERRIDE_SECONDS).count(0.0) > 10


def test_a_refusal_is_logged_again_for_the_next_drive(base: Base, caplog: pytest.LogCaptureFixture) -> None:
    base.drivers["7"] = "anna (web)"
    for pause in (0.1, 0.1, 0.1, 60.0, 0.1):
        with pytest.raises(RequestError):
            base.commander.command(DRIVE, 0.2)
        base.after(pause)
    assert len(logged(caplog)) == 2


def test_a_stop_before_the_first_velocity_requires_no_pause(base: Base) -> None:
    base.clock.now = 0.0  # the machine has just started: a time that was never set must not count as recent
    base.commander.stop_client()
    base.commander.command(DRIVE, 0.2)
    assert base.received[-1] == 0.3


def test_a_stall_after_a_stop_does_not_count_as_a_pause(base: Base) -> None:
    """The client's messages of that time have not been read yet."""
    base.commander.command(DRIVE, 0.2)
    base.commander.stop_client()
    for stall in (0.4, 2.0):
        base.after(0.1)
        base.loop.stall(stall)
        base.after(stall)  # the client's next message waits
        with pytest.raises(RequestError, match="the robot was stopped"):
            base.commander.command(DRIVE, 0.2)
    base.after(0.25)
    base.loop.stall(2.0)  # just before the pause is over
    base.after(2.1)
    with pytest.raises(RequestError, match="the robot was stopped"):
        base.commander.command(DRIVE, 0.2)
    base.after(0.4)
    base.commander.command(DRIVE, 0.2)
    assert base.received[-1] == 0.3


def test_a_velocity_that_was_dropped_because_the_gateway_was_busy_is_no_pause(base: Base) -> None:
    base.commander.command(DRIVE, 0.2)
    base.commander.stop_client()
    for _ in range(5):
        base.after(0.25)
        base.commander.note(DRIVE, 0.2)
    base.after(0.25)
    with pytest.raises(RequestError, match="the robot was stopped"):
        base.commander.command(DRIVE, 0.2)
    base.commander.note(YarpVelocity(), 0.2)
    base.after(0.4)
    base.commander.command(DRIVE, 0.2)
    assert base.received[-1] == 0.3


@pytest.mark.parametrize("who", ["a person", "the planner"])
def test_a_client_that_was_refused_drives_only_after_a_pause(
    base: Base, caplog: pytest.LogCaptureFixture, who: str
) -> None:
    """Its operator has seen nothing move, and does not expect the robot to start when the other ends."""
    planner = who == "the planner"
    reason = "the planner drives; stop or suspend it first"
    if not planner:
        base.drivers["7"], reason = "anna (web)", "anna (web) drives manually"
    for _ in range(20):
        with pytest.raises(RequestError, match=re.escape(reason)):
            base.commander.command(DRIVE, 0.2, planner_drives=planner)
        base.after(0.1)
    base.drivers.clear()
    for _ in range(20):
        with pytest.raises(RequestError, match="the planner or a person drove; first send no velocity"):
            base.commander.command(DRIVE, 0.2)
        base.after(0.1)
    assert base.received == []
    assert [text.partition("; first")[0] for text in logged(caplog)] == [
        f"a velocity of a YARP client is refused: {reason}",
        "a velocity of a YARP client is refused: the planner or a person drove",
    ]
    base.commander.command(YarpVelocity(), 0.2)  # the joystick is released
    base.after(0.4)
    base.commander.command(DRIVE, 0.2)
    assert base.received[-1] == 0.3


def test_zeros_of_a_refused_client_require_no_pause(base: Base) -> None:
    for _ in range(5):
        with pytest.raises(RequestError, match="the planner drives"):
            base.commander.command(YarpVelocity(), 0.2, planner_drives=True)
        base.after(0.1)
    base.commander.command(DRIVE, 0.2)
    assert base.received == [0.3]


def test_a_stop_is_the_reason_for_a_pause_although_a_planner_drove_before(base: Base) -> None:
    with pytest.raises(RequestError, match="the planner drives"):
        base.commander.command(DRIVE, 0.2, planner_drives=True)
    base.commander.stop_client()
    for planner in (True, False):
        with pytest.raises(RequestError, match="the robot was stopped"):
            base.commander.command(DRIVE, 0.2, planner_drives=planner)


def test_nothing_runs_while_no_client_drives(base: Base) -> None:
    """An idle gateway is not woken up."""
    base.commander.command(DRIVE, 0.2)
    base.after(1.0)
    with pytest.raises(RequestError):
        base.commander.command(DRIVE, 0.2, planner_drives=True)
    base.after(5.0)
    assert not base.clock.pending


@pytest.mark.parametrize("ended", [True, False], ids=["it ends", "it crashes"])
@pytest.mark.parametrize("reason", ["the robot was stopped", "the planner or a person drove"])
def test_a_restart_does_not_end_the_need_to_pause(base: Base, reason: str, ended: bool) -> None:
    """The client repeats its velocity all the time, and its operator does not expect the robot to start."""
    base.commander.command(DRIVE, 0.2)
    base.commander.stop_client() if "stopped" in reason else base.commander.displace()
    for _ in range(2):
        base = base.restarted(ended=ended)
        for _ in range(30):
            with pytest.raises(RequestError, match=f"{reason}; first send no velocity"):
                base.commander.command(DRIVE, 0.2)
            base.after(0.1)
    assert base.received == []
    base.after(0.4)
    base.commander.command(DRIVE, 0.2)
    assert base.received == [0.3]


@pytest.mark.parametrize("ended", [True, False], ids=["it ends", "it crashes"])
@pytest.mark.parametrize("paused", [True, False])
def test_a_client_that_may_drive_needs_no_pause_after_a_restart(base: Base, paused: bool, ended: bool) -> None:
    base.commander.command(DRIVE, 0.2)
    if paused:
        base.commander.stop_client()
        base.after(1.0)
        base.commander.command(DRIVE, 0.2)
    base = base.restarted(ended=ended)
    base.commander.command(DRIVE, 0.2)
    assert base.received == [0.3]


def test_after_a_restart_a_client_is_silent_for_the_longest_time_out(base: Base) -> None:
    """The time-out of its last velocity is unknown, and its next one may be about to arrive."""
    base.commander.command(DRIVE, 1.0)
    base.commander.stop_client()
    base = base.restarted(ended=False)
    base.after(0.9)
    with pytest.raises(RequestError, match="the robot was stopped"):
        base.commander.command(DRIVE, 1.0)
    base = base.restarted(ended=False)
    base.after(1.1)
    base.commander.command(DRIVE, 1.0)
    assert base.received == [0.3]
    base.after(5.0)
    assert not base.clock.pending


def test_an_unreadable_file_requires_a_pause(base: Base, tmp_path: Path) -> None:
    (tmp_path / "pause").write_text("", encoding="utf-8")  # the gateway crashed while it was writing
    base = base.restarted(ended=True)
    with pytest.raises(RequestError, match="the robot was stopped"):
        base.commander.command(DRIVE, 0.2)
