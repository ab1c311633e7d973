"""What is known of where the robot is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from navigation.pose import Pose

Floats = NDArray[np.float64]


class Status(StrEnum):
    """YARP's ``LocalizationStatusEnum``, by its names."""

    NOT_YET = "not_yet_localized"
    OK = "localized_ok"
    ERROR = "error"


@dataclass(frozen=True)
class Estimate:
    """Where the robot is.

    Attributes:
        pose: on the map; None before a start was given.
        covariance: (3, 3) of x, y, theta: metres, radians.
        quality: share of the scan that the map explains, less what speaks against it, 0 to 1.
        status: whether to rely on it.
        reason: why not.
    """

    pose: Pose | None
    covariance: Floats
    quality: float
    status: Status
    reason: str


def unknown(reason: str, status: Status = Status.NOT_YET) -> Estimate:
    """Nothing is known."""
    return Estimate(None, np.zeros((3, 3)), 0.0, status, reason)


def covariance_of(metres: float, radians: float) -> Floats:
    """The covariance (3, 3) of standard deviations that are the same in x and y."""
    return np.diag([metres**2, metres**2, radians**2])
