"""The zero velocities at the end of a play, with a stand-in for the hub."""

from __future__ import annotations

import itertools
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
