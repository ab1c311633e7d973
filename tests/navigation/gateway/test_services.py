"""Velocities of YARP clients: repeated while they last, then zero for a moment, unless a planner drives."""

from __future__ import annotations

import logging
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.client.velocity import STOP_SECONDS
from bridge.hub.errors import HubClosedError
from navigation.gateway import services
from navigation.gateway.choice import RequestError
from navigation.gateway.services import VelocityCommander, YarpVelocity
from tests.peers.navigation.simulated_hub import Clock, Loop

DRIVE = YarpVelocity(0.3, 0.0, 0.0)
ZEROS = round(STOP_SECONDS / services._PERIOD)


class Base:
    """A commander on a simulated clock, and the velocities that it publishes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock, self.received, self.busy = Clock(), list[float](), False
        self.loop = Loop(self.clock)
        self.fails = False  # whether publishing fails
        publisher = SimpleNamespace(publish=self._publish)
        monkeypatch.setattr(services, "velocity_publisher", lambda *_: publisher)
        monkeypatch.setattr(services, "time", self.clock)
        self.drivers = dict[str, str]()  # other persons by zid; that of the gateway is "5"
        self.announced: str | None = None
        graph = SimpleNamespace(drivers=lambda _topic: self.drivers)
        hub = SimpleNamespace(graph=graph, zid="5", announce_driver=self._announce)
        host: Any = SimpleNamespace(
            loop=self.loop, name="gateway", node=SimpleNamespace(hub=hub), log=logging.getLogger("gateway")
        )
        self.commander = VelocityCommander(host, "/cmd_vel", lambda: self.busy)

    def _publish(self, x: float, _y: float, _turn: float) -> None:
        if self.fails:
            raise HubClosedError("this node of the hub is closed")
        self.received.append(x)

    def _announce(self, _topic: str, who: str) -> Callable[[], None]:
        self.announced = who
        return lambda: setattr(self, "announced", None)

    def after(self, seconds: float) -> list[float]:
        """Return the velocities of the next seconds."""
        begin = len(self.received)
        self.clock.run_to(self.clock.now + seconds)
        return self.received[begin:]


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> Base:
    return Base(monkeypatch)


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
    assert [record.getMessage() for record in caplog.records] == [
        "a velocity of a YARP client is refused: anna (web) drives manually"
    ]
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


def test_a_stop_that_cannot_be_published_lets_others_drive(base: Base) -> None:
    base.commander.command(DRIVE, 1.0)
    base.fails = True
    with pytest.raises(HubClosedError):
        base.commander.stop()
    assert base.announced is None
    base.fails = False
    base.after(5.0)
    assert base.received[1:] == [0.0] * (ZEROS - 1), "the timer repeats zero"


def test_the_end_is_reported_although_the_stop_cannot_be_published(base: Base) -> None:
    ended: list[bool] = []
    base.commander.command(DRIVE, 1.0)
    base.fails = True
    with pytest.raises(HubClosedError):
        base.commander.end(lambda: ended.append(True))
    base.fails = False
    base.after(5.0)
    assert ended == [True]
