"""The tree of frames that transforms form, and the pose of any frame in any other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.sig.matrix import Quaternion

Pose = NDArray[np.float64]
"""(4, 4) in meters: transforms points from a frame to its reference frame."""


class TransformError(LookupError):
    """Raised if a frame is unknown, or two frames are not connected."""


class FrameTree:
    """Frames with their parents; if a frame has two parents, the first counts, as in YARP."""

    def __init__(self, transforms: Iterable[FrameTransform] = ()) -> None:
        self.transforms = list(transforms)
        self._above: dict[str, FrameTransform] = {}
        for transform in self.transforms:
            self._above.setdefault(transform.dst_frame_id, transform)

    def names(self) -> list[str]:
        """Return all frames in YARP's order: those with children, then the others."""
        parents = dict.fromkeys(transform.src_frame_id for transform in self.transforms)
        return list(parents | dict.fromkeys(transform.dst_frame_id for transform in self.transforms))

    def __contains__(self, name: object) -> bool:
        return name in self._above or any(transform.src_frame_id == name for transform in self.transforms)

    def parent(self, name: str) -> str | None:
        """Return a frame's parent, or None."""
        transform = self._above.get(name)
        return None if transform is None else transform.src_frame_id

    def direct(self, child: str, parent: str) -> bool:
        """Whether a single transform gives the child's pose in the parent."""
        return any(t.dst_frame_id == child and t.src_frame_id == parent for t in self.transforms)

    def connected(self, first: str, second: str) -> bool:
        """Whether two frames are connected; a frame is connected to itself, even an unknown one."""
        return first == second or not {*self._path_up(first)}.isdisjoint(self._path_up(second))

    def pose(self, child: str, parent: str) -> Pose:
        """Return the pose of a frame in another, anywhere in the tree; raises `TransformError` if not connected."""
        if child == parent:
            return np.eye(4)
        down, up = self._path_up(child), self._path_up(parent)
        common = next((name for name in down if name in up), None)
        if common is None:
            raise TransformError(self._reason(child, parent))
        result: Pose = inverse(self._along(up[: up.index(common)])) @ self._along(down[: down.index(common)])
        return result

    def _along(self, path: Sequence[str]) -> Pose:
        """Return the pose of a path's first frame in the parent of its last."""
        pose = np.eye(4)
        for frame in path:
            pose = matrix_of(self._above[frame]) @ pose
        return pose

    def _path_up(self, name: str) -> list[str]:
        """Return a frame and all its ancestors; a loop is followed once."""
        path = [name]
        seen = {name}
        while (above := self.parent(path[-1])) is not None and above not in seen:
            path.append(above)
            seen.add(above)
        return path

    def _reason(self, child: str, parent: str) -> str:
        unknown = next((name for name in (child, parent) if name not in self), None)
        if unknown is not None:
            return f"unknown frame {unknown!r}; known frames: {', '.join(self.names()) or 'none'}"
        return f"{child!r} and {parent!r} are in trees that are not connected"


def matrix_of(transform: FrameTransform) -> Pose:
    """Convert a transform to a matrix."""
    matrix = Quaternion(transform.qX, transform.qY, transform.qZ, transform.qW).toRotationMatrix4x4().numpy()
    matrix[:3, 3] = transform.tX, transform.tY, transform.tZ
    return matrix


def transform_of(child: str, parent: str, pose: ArrayLike, stamp: float, *, static: bool = False) -> FrameTransform:
    """Convert a matrix to a transform; raises `ValueError` unless it is 4 by 4."""
    given = np.asarray(pose, float)
    if given.shape != (4, 4):
        raise ValueError(f"a transform must be a 4 by 4 matrix, not {given.shape}")
    rotation = Quaternion()
    rotation.fromRotationMatrix(given)
    x, y, z = given[:3, 3].tolist()
    return FrameTransform(
        parent, child, stamp, int(static), x, y, z, rotation.x(), rotation.y(), rotation.z(), rotation.w()
    )  # fmt: skip


def inverse(pose: Pose) -> Pose:
    """Return the inverse of a pose."""
    result = np.eye(4)
    result[:3, :3] = pose[:3, :3].T
    result[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return result


def of_angles(roll: float, pitch: float, yaw: float) -> Pose:
    """Convert roll, pitch and yaw in radians to a matrix, like `yarp::math::rpy2dcm`."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return matrix


def angles_of(pose: Pose) -> tuple[float, float, float]:
    """Convert a pose to roll, pitch and yaw in radians, like `yarp::math::dcm2rpy`: roll is 0 at the singularity."""
    if pose[2, 0] >= 1.0:
        return 0.0, -math.pi / 2, math.atan2(-pose[1, 2], pose[1, 1])
    if pose[2, 0] <= -1.0:
        return 0.0, math.pi / 2, -math.atan2(-pose[1, 2], pose[1, 1])
    return math.atan2(pose[2, 1], pose[2, 2]), math.asin(-pose[2, 0]), math.atan2(pose[1, 0], pose[0, 0])
