"""The tree that transforms make, and where any of its frames is in any other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.sig.matrix import Quaternion

Pose = NDArray[np.float64]
"""(4, 4): takes a point's coordinates in the frame to those in the frame that it is given in; metres."""


class TransformError(LookupError):
    """There is no such frame, or no way between two."""


class FrameTree:
    """Frames with their parents; of a frame that has two parents the first counts, as in YARP."""

    def __init__(self, transforms: Iterable[FrameTransform] = ()) -> None:
        self.transforms = list(transforms)
        self._above: dict[str, FrameTransform] = {}
        for transform in self.transforms:
            self._above.setdefault(transform.dst_frame_id, transform)

    def names(self) -> list[str]:
        """All frames, in YARP's order: those that have children, then the others."""
        parents = dict.fromkeys(transform.src_frame_id for transform in self.transforms)
        return list(parents | dict.fromkeys(transform.dst_frame_id for transform in self.transforms))

    def __contains__(self, name: object) -> bool:
        return name in self._above or any(transform.src_frame_id == name for transform in self.transforms)

    def parent(self, name: str) -> str | None:
        """A frame's parent, None for one without."""
        transform = self._above.get(name)
        return None if transform is None else transform.src_frame_id

    def direct(self, child: str, parent: str) -> bool:
        """Whether one transform leads from one to the other."""
        return any(t.dst_frame_id == child and t.src_frame_id == parent for t in self.transforms)

    def connected(self, one: str, other: str) -> bool:
        """Whether there is a way between two frames; a frame is connected to itself, known or not."""
        return one == other or not {*self._way(one)}.isdisjoint(self._way(other))

    def pose(self, child: str, parent: str) -> Pose:
        """The pose of a frame in another, anywhere in the tree; raises `TransformError` where nothing connects them."""
        if child == parent:
            return np.eye(4)
        down, up = self._way(child), self._way(parent)
        common = next((name for name in down if name in up), None)
        if common is None:
            raise TransformError(self._why(child, parent))
        result: Pose = inverse(self._along(up[: up.index(common)])) @ self._along(down[: down.index(common)])
        return result

    def _along(self, way: Sequence[str]) -> Pose:
        """The pose of the first frame of a way up in the parent of the last."""
        found = np.eye(4)
        for step in way:
            found = matrix_of(self._above[step]) @ found
        return found

    def _way(self, name: str) -> list[str]:
        """A frame and all above it; a loop is gone through once."""
        way = [name]
        seen = {name}
        while (above := self.parent(way[-1])) is not None and above not in seen:
            way.append(above)
            seen.add(above)
        return way

    def _why(self, child: str, parent: str) -> str:
        unknown = next((name for name in (child, parent) if name not in self), None)
        if unknown is not None:
            return f"there is no frame {unknown!r}; those that there are: {', '.join(self.names()) or 'none'}"
        return f"{child!r} and {parent!r} are in trees that are not connected"


def matrix_of(transform: FrameTransform) -> Pose:
    """A transform as a matrix."""
    found = Quaternion(transform.qX, transform.qY, transform.qZ, transform.qW).toRotationMatrix4x4().numpy()
    found[:3, 3] = transform.tX, transform.tY, transform.tZ
    return found


def transform_of(child: str, parent: str, pose: ArrayLike, stamp: float, *, static: bool = False) -> FrameTransform:
    """A matrix as a transform; raises `ValueError` where it is not 4 by 4."""
    given = np.asarray(pose, float)
    if given.shape != (4, 4):
        raise ValueError(f"a transform is a matrix of 4 by 4, not of {given.shape}")
    turned = Quaternion()
    turned.fromRotationMatrix(given)
    x, y, z = given[:3, 3].tolist()
    return FrameTransform(
        parent, child, stamp, int(static), x, y, z, turned.x(), turned.y(), turned.z(), turned.w()
    )  # fmt: skip


def inverse(pose: Pose) -> Pose:
    """The transform the other way."""
    found = np.eye(4)
    found[:3, :3] = pose[:3, :3].T
    found[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return found


def of_angles(roll: float, pitch: float, yaw: float) -> Pose:
    """Roll, pitch and yaw in radians as a matrix: `yarp::math::rpy2dcm`."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    found = np.eye(4)
    found[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return found


def angles_of(pose: Pose) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians: `yarp::math::dcm2rpy`, which takes roll for 0 where only a sum is known."""
    if pose[2, 0] >= 1.0:
        return 0.0, -math.pi / 2, math.atan2(-pose[1, 2], pose[1, 1])
    if pose[2, 0] <= -1.0:
        return 0.0, math.pi / 2, -math.atan2(-pose[1, 2], pose[1, 1])
    return math.atan2(pose[2, 1], pose[2, 2]), math.asin(-pose[2, 0]), math.atan2(pose[1, 0], pose[0, 0])
