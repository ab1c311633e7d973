"""The buffer's results: a transform, transforms at many times, and information on a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

LATEST = 0
"""A stamp that requests the newest time at which all frames on the path are known."""


class Transform(NamedTuple):
    """The pose of ``child_frame_id`` in ``frame_id``, which transforms coordinates from the child to the parent."""

    frame_id: str
    child_frame_id: str
    stamp: int  #: ns; 0 if it is valid at all times
    translation: Vector  #: x, y, z in m
    rotation: Quaternion  #: x, y, z, w


@dataclass(frozen=True, slots=True)
class TransformsInTime:
    """The results of a lookup at N times."""

    stamps: NDArray[np.int64]  #: (N), ns
    translations: NDArray[np.float64]  #: (N, 3) in m; NaN if unknown
    rotations: NDArray[np.float64]  #: (N, 4), x, y, z, w; NaN if unknown
    known: NDArray[np.bool_]  #: (N), whether the transform is known


@dataclass(frozen=True, slots=True)
class TransformSource:
    """A source of a frame's transforms."""

    parent: str
    authority: str
    stamp: int  #: ns, of its newest transform


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """Information on a frame that has a parent."""

    name: str
    parent: str
    authority: str
    static: bool
    oldest: int  #: stamp in ns; 0 if static
    newest: int  #: stamp in ns; 0 if static
    samples: int
    sources: tuple[TransformSource, ...]  #: all within the history; more than one if several publishers send the frame

    @property
    def rate(self) -> float:
        """Transforms per second; 0 if the frame is static or has fewer than two."""
        seconds = (self.newest - self.oldest) / 1e9
        return (self.samples - 1) / seconds if seconds > 0 else 0.0

    @property
    def parents(self) -> set[str]:
        """All parents within the history."""
        return {source.parent for source in self.sources}


def angles_of(rotation: Quaternion) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in radians: rotations about the fixed axes x, then y, then z (REP 103).

    All are 0 for a quaternion of zeros, which some programs send.
    """
    x, y, z, w = rotation
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    roll = math.atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
    yaw = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return roll, pitch, yaw
