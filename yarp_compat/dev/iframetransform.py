"""YARP's interface ``IFrameTransform`` (`yarp/dev/IFrameTransform.h`, `frameTransformClient`).

YARP's target is the frame whose pose is requested, its source the reference frame: ``getTransform("laser", "map", m)``
is the pose of the laser on the map; tf2 calls that "from source laser to target map".
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, MutableSequence
from typing import Any

import numpy as np

from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametree import FrameTree, TransformError, angles_of, of_angles, transform_of
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode, ReturnValue, deliver, invoke
from yarp_compat.os.time import now
from yarp_compat.sig.matrix import Matrix, Quaternion
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError

_OK = ReturnCode.OK
_FAILED = ReturnCode.METHOD_FAILED
Query = Callable[[FrameTree], Any]


class IFrameTransform(ABC):
    """The interface under YARP's names. Results that C++ returns by reference are filled in here too.

    A boolean or a text, which Python cannot fill in, becomes the only element of a list (`BVector`, `SVector`);
    without a list the method returns it, as the bindings of YARP 3 do. Nothing raises: a failed call returns a false
    outcome.
    """

    TRANSFORM_OK, TRANSFORM_GENERAL_ERROR, TRANSFORM_TIMEOUT = 0, 1, 2

    @abstractmethod
    def tree(self) -> FrameTree:
        """Return all current frames; raises `OSError` if the server is unreachable, `CallFailed` if it refuses."""

    @abstractmethod
    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Set transforms."""

    @abstractmethod
    def remove(self, first: str, second: str) -> ReturnValue:
        """Delete the transforms between two frames; ``*`` matches any frame."""

    @abstractmethod
    def remove_all(self) -> ReturnValue:
        """Delete all transforms."""

    @abstractmethod
    def wait_until(self, known: Callable[[FrameTree], bool], timeout: float) -> bool:
        """Wait until the frames meet a condition; False after ``timeout`` seconds."""

    def allFramesAsString(self, all_frames: MutableSequence[str] | None = None) -> Any:
        """Return all transforms as text."""
        return deliver(*self._query(lambda tree: "".join(_text(t) + " " for t in tree.transforms)), all_frames)

    def canTransform(
        self, target_frame: str, source_frame: str, canTransform: MutableSequence[bool] | None = None
    ) -> Any:
        """Whether two frames are connected."""
        return deliver(*self._query(lambda tree: tree.connected(target_frame, source_frame)), canTransform)

    def clear(self) -> ReturnValue:
        return invoke(self.remove_all)

    def frameExists(self, frame_id: str, exists: MutableSequence[bool] | None = None) -> Any:
        """Whether a frame exists."""
        return deliver(*self._query(lambda tree: frame_id in tree), exists)

    def getAllFrameIds(self, ids: MutableSequence[str] | None = None) -> Any:
        """Return the names of all frames, in a list if one is given."""
        outcome, names = self._query(FrameTree.names)
        return deliver(outcome, list(names or ()), ids)

    def getParent(self, frame_id: str, parent_frame_id: MutableSequence[str] | None = None) -> Any:
        """Return the parent of a frame; for a root, fail, or return ``unknown`` if no list is given."""
        outcome, parent = self._query(lambda tree: tree.parent(frame_id))
        return deliver(outcome if parent is not None else _or_failed(outcome), parent or "unknown", parent_frame_id)

    def getTransform(self, target_frame: str, source_frame: str, transform: Matrix) -> ReturnValue:
        """Store the pose of the target in the source, as a 4 by 4 matrix."""
        outcome, pose = self._query(lambda tree: tree.pose(target_frame, source_frame))
        if outcome:
            transform.resize(4, 4)
            transform.setSubmatrix(Matrix(pose), 0, 0)
        return outcome

    def setTransform(self, target_frame: str, source_frame: str, transform: Matrix) -> ReturnValue:
        """Set the pose of the target in the source; fails if other transforms already define it."""

        def follows(tree: FrameTree) -> bool:
            return tree.connected(target_frame, source_frame) and not tree.direct(target_frame, source_frame)

        return self._set(target_frame, source_frame, transform, follows, static=False)

    def setTransformStatic(self, target_frame: str, source_frame: str, transform: Matrix) -> ReturnValue:
        """Set the static pose of the target in the source; fails if they are already connected."""
        connected = self._connected(target_frame, source_frame)
        return self._set(target_frame, source_frame, transform, connected, static=True)

    def deleteTransform(self, target_frame: str, source_frame: str) -> ReturnValue:
        """Delete the transform between two frames, whichever is the parent; ``*`` matches any frame."""
        return invoke(self.remove, target_frame, source_frame)

    def transformPoint(
        self, target_frame: str, source_frame: str, input_point: Vector, transformed_point: Vector
    ) -> ReturnValue:
        """Transform a point (x, y, z) from the target to the source."""
        if len(input_point) != 3:
            return ReturnValue(_FAILED)
        outcome, pose = self._query(lambda tree: tree.pose(target_frame, source_frame))
        if outcome:
            _fill(transformed_point, pose[:3, :3] @ np.asarray(input_point) + pose[:3, 3])
        return outcome

    def transformPose(
        self, target_frame: str, source_frame: str, input_pose: Vector, transformed_pose: Vector
    ) -> ReturnValue:
        """Transform a pose (x, y, z, roll, pitch, yaw) from the target to the source."""
        if len(input_pose) != 6:
            return ReturnValue(_FAILED)
        outcome, pose = self._query(lambda tree: tree.pose(target_frame, source_frame))
        if outcome:
            x, y, z, roll, pitch, yaw = np.asarray(input_pose, float).tolist()
            given = of_angles(roll, pitch, yaw)
            given[:3, 3] = x, y, z
            result = pose @ given
            _fill(transformed_pose, [*result[:3, 3].tolist(), *angles_of(result)])
        return outcome

    def transformQuaternion(
        self, target_frame: str, source_frame: str, input_quaternion: Quaternion, transformed_quaternion: Quaternion
    ) -> ReturnValue:
        """Transform a rotation from the target to the source."""
        outcome, rotation = self._query(
            lambda tree: tree.pose(target_frame, source_frame) @ input_quaternion.toRotationMatrix4x4().numpy()
        )
        if outcome:
            transformed_quaternion.fromRotationMatrix(rotation)
        return outcome

    def waitForTransform(self, target_frame: str, source_frame: str, timeout: float) -> ReturnValue:
        """Wait until two frames are connected; fails after ``timeout`` seconds."""
        known = self._connected(target_frame, source_frame)
        try:
            return ReturnValue(_OK if self.wait_until(known, timeout) else _FAILED)
        except CallFailed as err:
            return ReturnValue(err.code)
        except (OSError, WireError):
            return ReturnValue(ReturnCode.COMMUNICATION)

    @staticmethod
    def _connected(first: str, second: str) -> Callable[[FrameTree], bool]:
        return lambda tree: tree.connected(first, second)

    def _query(self, query: Query) -> tuple[ReturnValue, Any]:
        """Return the outcome and the result of a query on the frames; None on failure."""
        try:
            return ReturnValue(_OK), query(self.tree())
        except (TransformError, ValueError):
            return ReturnValue(_FAILED), None
        except CallFailed as err:
            return ReturnValue(err.code), None
        except (OSError, WireError):
            return ReturnValue(ReturnCode.COMMUNICATION), None

    def _set(self, child: str, parent: str, transform: Matrix, conflict: Query, *, static: bool) -> ReturnValue:
        outcome, conflicting = self._query(conflict)
        if child == parent or conflicting or not outcome:
            return _or_failed(outcome)
        try:
            message = transform_of(child, parent, transform, now(), static=static)
        except ValueError:
            return ReturnValue(_FAILED)
        return invoke(self.send, [message])


def _or_failed(outcome: ReturnValue) -> ReturnValue:
    return outcome if not outcome else ReturnValue(_FAILED)


def _fill(vector: Vector, values: Any) -> None:
    vector.resize(len(values))
    for place, value in enumerate(values):
        vector[place] = float(value)


def _text(transform: FrameTransform) -> str:
    """Return a transform as YARP prints it (`FrameTransform::toString`)."""
    t = transform
    return (
        f"{t.src_frame_id} -> {t.dst_frame_id} \n tran: {t.tX:f} {t.tY:f} {t.tZ:f} \n"
        f" rot quaternion: {t.qX:f} {t.qY:f} {t.qZ:f} {t.qW:f}\n\n"
    )
