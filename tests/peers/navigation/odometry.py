"""Odometry of a base that the test moves."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

from bridge.clock import SYSTEM
from tests.contract.hubside import HubSide

_PERIOD = 0.05


class Odometry:
    """Publishes ``/tf`` from odom to base_link, and from map to odom, as a base's driver and a localizer do.

    Attributes:
        speed: m/s along x; the test sets it.
        x: the base's position, meters.
        silent: whether publishing is paused.
    """

    def __init__(self, far: HubSide) -> None:
        self._far = far
        self.speed = self.x = 0.0
        self.silent = False
        self._out = far.advertise("/tf", "tf2_msgs/TFMessage")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="odometry", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._end.wait(_PERIOD):
            self.x += self.speed * _PERIOD
            if self.silent:
                continue
            stamp = SYSTEM.stamp()
            frames = [("odom", "base_link", self.x), ("map", "odom", 0.0)]
            transforms = [
                {
                    "header": {"stamp": stamp, "frame_id": parent},
                    "child_frame_id": child,
                    "transform": {"translation": {"x": x}, "rotation": {"w": 1.0}},
                }
                for parent, child, x in frames
            ]
            self._far.publish(self._out, {"transforms": transforms})
