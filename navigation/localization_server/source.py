"""Who says where the robot is, as the module sees each of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np

from navigation.localization_server.estimate import Estimate, Floats
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D


class Start(NamedTuple):
    """Where the robot is, as somebody said: on a map that is taken for it.

    Attributes:
        covariance: (3, 3) of x, y, theta: metres, radians; None: as sure as usual.
    """

    pose: Pose
    covariance: Floats | None = None


class Source(ABC):
    """One that says where the robot is. On the module's thread.

    Attributes:
        hears_starts: whether starts that are told on a topic are for it; who hears them by itself is not told twice.
        corrects: whether the odometry's frame on the map is to be published for it.
    """

    hears_starts = False
    corrects = False

    @abstractmethod
    def estimate(self) -> Estimate:
        """Where the robot is now, or why nobody knows."""

    def correction(self) -> Pose | None:
        """The odometry's frame on the map, where `corrects`; None where it is not known now."""
        return None

    def cloud(self) -> Floats:
        """Where the robot may be, (n, 3): metres, radians."""
        return np.empty((0, 3))

    @abstractmethod
    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Begin there; None: with the usual covariance. Raises `RuntimeError` with why it cannot."""

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:  # noqa: ARG002 - most need not know the map
        """Another map is in use, or the first; ``start`` is where the robot is on it, where somebody said so.

        Raises:
            RuntimeError: it cannot begin there; the text says why.
        """
        if start is not None:
            self.initial(*start)

    def rest(self, *, on: bool) -> None:  # noqa: B027 - most need not
        """Work no more, or again."""

    def forget(self) -> None:  # noqa: B027 - most need not
        """The clock was set back."""

    def status(self) -> dict[str, Any]:
        """What it tells beside, for the status document."""
        return {}

    def close(self) -> None:  # noqa: B027 - most need not
        """End what it began by itself."""
