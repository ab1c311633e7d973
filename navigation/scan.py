"""Scans of the hub and of YARP's ports, as all modules take them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.laserscan import LaserScan2D

SCAN = "sensor_msgs/msg/LaserScan"

_LEAST = 1e-3
"""Metres; nearer is what some lasers say where they saw nothing, and that is not known to be free."""


class Beams(Protocol):
    """A scan: directions in radians, distances in metres (`Turn`, `sim.laser.Scan`)."""

    @property
    def first(self) -> float:
        """The first beam's direction on the laser."""

    @property
    def step(self) -> float:
        """From each beam to the next."""

    @property
    def nearest(self) -> float:
        """What is nearer was not measured."""

    @property
    def farthest(self) -> float:
        """What is as far or farther was not measured."""

    @property
    def ranges(self) -> NDArray[np.floating]:
        """Metres; infinite where nothing was hit, NaN where nothing is known, minus infinity where it is too near."""


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn of a laser; see `Beams`. ``time_ns``: when it was made."""

    time_ns: int
    first: float
    step: float
    nearest: float
    farthest: float
    ranges: NDArray[np.float64]

    def turned_over(self) -> Turn:
        """The same of a laser that hangs upside down: seen from above, its beams go round the other way."""
        return replace(self, first=-self.first, step=-self.step)


class ScanError(ValueError):
    """A scan that cannot be used; the text says why."""


def of_ros(message: Mapping[str, Any], time_ns: int, *, hangs: bool = False) -> Turn:
    """The turn of a ``sensor_msgs/msg/LaserScan``.

    Args:
        message: as `bridge.messages.values` has it.
        time_ns: when it was made, on the clock of whoever takes it.
        hangs: whether the laser hangs upside down.

    Raises:
        ScanError: its angles or limits are none.
    """
    made = _turn(
        time_ns, message["angle_min"], message["angle_increment"], message["range_min"], message["range_max"],
        np.array(message["ranges"], np.float64),
    )  # fmt: skip
    return made.turned_over() if hangs else made


def of_yarp(scan: LaserScan2D, time_ns: int) -> Turn:
    """The turn of a YARP laser: degrees, the last angle being one step beyond the last beam.

    Raises:
        ScanError: its angles or limits are none.
    """
    ranges = np.array(scan.scans, np.float64)
    step = math.radians(scan.angle_max - scan.angle_min) / max(len(ranges), 1)
    return _turn(time_ns, math.radians(scan.angle_min), step, scan.range_min, scan.range_max, ranges)


def _turn(
    time_ns: int, first: float, step: float, nearest: float, farthest: float, ranges: NDArray[np.float64]
) -> Turn:
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0 and len(ranges)):
        raise ScanError(f"a scan of {len(ranges)} beams from {first:g} by {step:g} rad")
    if abs(step) * len(ranges) > 2.5 * math.pi:
        raise ScanError(f"a scan of {len(ranges)} beams with {step:g} rad between them goes round more than once")
    if not farthest > max(nearest, 0.0):
        raise ScanError(f"a scan that measures from {nearest:g} to {farthest:g} m")
    return Turn(time_ns, first, step, max(nearest, _LEAST), farthest, ranges)


def is_blind(scan: Beams) -> bool:
    """Whether none of its beams says anything: many lasers that are covered or broken say 0 all round."""
    ranges = np.asarray(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        return not ((ranges >= scan.nearest) | (ranges == -np.inf)).any()


def believed(scan: Beams) -> NDArray[np.float64]:
    """The ranges: NaN where nothing is known, also nearer than is measured; infinite from the farthest on.

    A range of just ``range_max`` is no echo: many lasers say it where nothing was hit.
    """
    ranges = np.array(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        ranges[ranges < scan.nearest] = np.nan
        ranges[ranges >= scan.farthest] = np.inf
    return ranges
