"""Velocities of YARP clients: repeated while they last, then zero for a moment, unless a planner drives."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bridge.client.velocity import STOP_SECONDS
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
        publisher = SimpleNamespace(publish=lambda x, _y, _turn: self.received.append(x))
        monkeypatch.setattr(services, "velocity_publisher", lambda *_: publisher)
        monkeypatch.setattr(services, "time", self.clock)
        host: Any = SimpleNamespace(loop=self.loop)
        self.commander = VelocityCommander(host, "/cmd_vel", lambda: self.busy)

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
