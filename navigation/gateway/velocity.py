"""Velocities that clients command past the planner, for as long as they say."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

from bridge.hub.qos import Qos
from bridge.modules.host import Host
from bridge.modules.loop import Timer

TWIST = "geometry_msgs/msg/Twist"
LONGEST_SECONDS = 1.0
"""A client that wants to drive on says so again: who has gone is not obeyed for longer."""

_PERIOD = 0.05


class Velocity(NamedTuple):
    """m/s, m/s, deg/s."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


class Commander:
    """Says a velocity again and again until its time is over, and then that it is zero. On the module's thread.

    Args:
        host: the module's.
        topic: where the base hears it.
    """

    def __init__(self, host: Host, topic: str) -> None:
        self._host = host
        self._out = host.node.publisher(topic, TWIST, Qos(depth=1), priority="command")
        self._velocity, self._until = Velocity(), 0.0
        self._timer: Timer | None = None

    @property
    def last(self) -> Velocity | None:
        """What is commanded, None once its time is over."""
        return self._velocity if time.monotonic() <= self._until else None

    def command(self, velocity: Velocity, seconds: float) -> None:
        """Command for so many seconds."""
        self._velocity, self._until = velocity, time.monotonic() + min(max(seconds, 0.0), LONGEST_SECONDS)
        self._publish(velocity)
        if self._timer is None:
            self._timer = self._host.loop.every(_PERIOD, self._again)

    def stop(self) -> None:
        """Command nothing more; the base stands where it was being commanded."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None
            self._until = 0.0
            self._publish(Velocity())

    def _again(self) -> None:
        if self.last is None:
            self.stop()
        else:
            self._publish(self._velocity)

    def _publish(self, velocity: Velocity) -> None:
        turn = math.radians(velocity.turn)
        self._out.publish({"linear": {"x": velocity.x, "y": velocity.y}, "angular": {"z": turn}})
