"""The start of a play and the zero velocities at its end, with a stand-in for the hub."""

from __future__ import annotations

import itertools
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.bags.bag import BagTopic
from bridge.bags.play import output as play_output
from bridge.bags.play.output import HubOutput
from bridge.bags.play.topics import PlayTopic
from bridge.hub.wire.qos import Qos
from bridge.messages.definitions.schema import World
from bridge.messages.registry import Registry
from tests.support.clock import Clock

TWIST = "geometry_msgs/msg/Twist"
DRIVE = PlayTopic(BagTopic("/cmd_vel", TWIST, World.ROS2), "/cmd_vel", TWIST, "", None, "", Qos(), command=True)


class Publisher:
    """A publisher that records what it is sent."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def put(self, data: bytes) -> None:
        self.sent.append(data)

    def close(self) -> None: ...


def test_zero_is_repeated_although_the_whole_machine_stalls(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stall also delays the worker that receives zero, which then drops the first one."""
    seconds = itertools.count()  # the clock advances by a second between any two steps
    monkeypatch.setattr(play_output, "time", SimpleNamespace(monotonic=lambda: next(seconds)))
    monkeypatch.setattr(play_output, "_STOP_PERIOD", 0.0)
    publisher = Publisher()
    hub: Any = SimpleNamespace(publisher=lambda *_, **__: publisher, serve=lambda *_: lambda: None)
    played = HubOutput(hub, Registry(), [DRIVE])
    played.put(DRIVE, b"velocity")
    played.finish()
    played.close()
    velocity, *zeros = publisher.sent
    assert velocity == b"velocity"
    assert len(zeros) == 1 + play_output._ZEROS
    assert len(set(zeros)) == 1


class Subscribed(Publisher):
    """A publisher whose subscriber zenoh matches at a time of the test's clock."""

    topic = DRIVE.name

    def __init__(self, clock: Clock, at: float) -> None:
        super().__init__()
        self._clock, self._at = clock, at

    def matched(self) -> bool:
        return self._clock.now >= self._at


@pytest.mark.parametrize(
    ("appears", "matched", "expected", "waited"),
    [
        (0.5, 3.0, (["/cmd_vel"], []), 3.0),
        (0.5, 9.0, (["/cmd_vel"], ["/cmd_vel"]), 5.0),
        (9.0, 9.0, ([], []), 1.0),
    ],
)
def test_a_play_waits_for_the_subscribers_that_appear_soon(
    monkeypatch: pytest.MonkeyPatch,
    appears: float,
    matched: float,
    expected: tuple[list[str], list[str]],
    waited: float,
) -> None:
    clock = Clock()
    begin = clock.now
    publisher = Subscribed(clock, begin + matched)

    def subscriptions(_topic: str) -> list[Any]:
        return [SimpleNamespace(own=False)] if clock.now >= begin + appears else []

    class Ended(threading.Event):
        """Lets time pass instead of waiting."""

        def wait(self, timeout: float | None = None) -> bool:
            clock.now += timeout or 0.0
            return False

    monkeypatch.setattr(play_output, "time", clock)
    graph = SimpleNamespace(subscriptions=subscriptions)
    hub: Any = SimpleNamespace(publisher=lambda *_, **__: publisher, serve=lambda *_: lambda: None, graph=graph)
    played = HubOutput(hub, Registry(), [DRIVE])
    assert played.await_listeners(1.0, 5.0, Ended()) == expected
    assert clock.now - begin == pytest.approx(waited, abs=0.2)
    played.close()
