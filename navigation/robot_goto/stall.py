"""Whether the base follows its commands, by its odometry."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navigation.pose import Pose, wrapped

ENOUGH = 0.2
"""Metres of commands after which it is looked what became of them."""

TRY = 0.05
"""The same of a base that did not follow, and is tried again."""

PAUSE = 2.0
"""Seconds between two tries."""

_SHARE = 0.2
_ARM = 0.2
"""Metres that one radian counts."""


class Stall:
    """Compares what was commanded with where odometry says that the base went.

    Attributes:
        since: seconds of when it did not follow first; None while it does.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self.since: float | None = None
        self._again = -math.inf
        self._wanted = 0.0
        self._from: Pose | None = None

    def add(self, now: float, passed: float, velocity: NDArray[np.float64], moved: Pose) -> None:
        """Take up a step.

        Args:
            now: seconds.
            passed: seconds since the step before.
            velocity: (3,) m/s forward and to the left and rad/s, that the base should have had.
            moved: where it is by its odometry.
        """
        if self._from is None:
            self._from = moved
            return
        self._wanted += passed * (math.hypot(velocity[0], velocity[1]) + _ARM * abs(velocity[2]))
        if self._wanted < (ENOUGH if self.since is None else TRY):
            return
        went = self._from.distance(moved) + _ARM * abs(wrapped(moved.theta - self._from.theta))
        if went >= _SHARE * self._wanted:
            self.since = None
        else:
            self.since = now if self.since is None else self.since
            self._again = now + PAUSE
        self._wanted, self._from = 0.0, moved

    def waits(self, now: float) -> bool:
        """Whether it does not follow, and is not to be tried again yet."""
        return self.since is not None and now < self._again
