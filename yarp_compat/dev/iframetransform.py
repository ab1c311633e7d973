"""``IFrameTransform`` as YARP users know it (`yarp/dev/IFrameTransform.h`, `frameTransformClient`).

YARP's target is the frame that is asked for, its source the one in which it is given:
``getTransform("laser", "map", m)`` is where the laser is on the map; tf2 calls that "from source laser to target map".
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, MutableSequence
from typing import Any

import numpy as np

from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametree import FrameTree, TransformError, angles_of, of_angles, transform_of
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue, called, given
from yarp_compat.os.time import now
from yarp_compat.sig.matrix import Matrix, Quaternion
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError

_OK = ReturnCode.OK
_FAILED = ReturnCode.METHOD_FAILED
Question = Callable[[FrameTree], Any]


class IFrameTransform(ABC):
    """The interface under YARP's names. What C++ returns by reference is filled in here too.

    A truth or a text, which Python cannot fill, goes into a list (`BVector`, `SVector`) as its one element; without a
    list the method returns it, as the bindings of YARP 3 do. Nothing raises: a call that fails returns an outcome that
    is false.
    """

    TRANSFORM_OK, TRANSFORM_GENERAL_ERROR, TRANSFORM_TIMEOUT = 0, 1, 2

    @abstractmethod
    def tree(self) -> FrameTree:
        """All frames as they are known now; raises `OSError` where the server is away."""

    @abstractmethod
    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Set transforms."""

    @abstractmethod
    def forget(self, one: str, other: str) -> ReturnValue:
        """Delete what is between two frames; ``*`` stands for any."""

    @abstractmethod
    def forget_all(self) -> ReturnValue:
        """Delete all transforms."""

    @abstractmethod
    def wait_until(self, known: Callable[[FrameTree], bool], timeout: float) -> bool:
        """Wait until something holds of the frames; whether it does in time."""

    def allFramesAsString(self, all_frames: MutableSequence[str] | None = None) -> Any:
        """All transforms as text."""
        return given(*self._asked(lambda tree: "".join(_words(t) + " " for t in tree.transforms)), all_frames)

    def canTransform(
        self, target_frame: str, source_frame: str, canTransform: MutableSequence[bool] | None = None
    ) -> Any:
        """Whether there is a way between two frames."""
        return given(*self._asked(lambda tree: tree.connected(target_frame, source_frame)), canTransform)

    def clear(self) -> ReturnValue:
        """Delete all transforms."""
        return called(self.forget_all)

    def frameExists(self, frame_id: str, exists: MutableSequence[bool] | None = None) -> Any:
        """Whether there is a frame."""
        return given(*self._asked(lambda tree: frame_id in tree), exists)

    def getAllFrameIds(self, ids: MutableSequence[str] | None = None) -> Any:
        """The names of all frames; returned by themselves where there is no list to fill."""
        outcome, names = self._asked(FrameTree.names)
        return given(outcome, list(names or ()), ids)

    def getParent(self, frame_id: str, parent_frame_id: MutableSequence[str] | None = None) -> Any:
        """The parent of a frame; it fails for a root, whose parent by itself is ``unknown``."""
        outcome, parent = self._asked(lambda tree: tree.parent(frame_id))
        return given(outcome if parent is not None else _or_failed(outcome), parent or "unknown", parent_frame_id)

    def getTransform(self, target_frame: str, source_frame: str, transform: Matrix) -> ReturnValue:
        """The pose of the target in the source, as a matrix of 4 by 4."""
        outcome, pose = self._asked(lambda tree: tree.pose(target_frame, source_frame))
        if outcome:
            transform.resize(4, 4)
            transform.setSubmatrix(Matrix(pose), 0, 0)
        return outcome

    def setTransform(self, target_frame: str, source_frame: str, transform: Matrix) -> ReturnValue:
        """Set the pose of the target in the source; fails where it follows from other transforms."""

        def follows(tree: FrameTree) -> bool:
            return tree.connected(target_frame, source_frame) and not tree.direct(target_frame, source_frame)

        return self._set(target_frame, source_frame, transform, follows, static=False)

    def setTransformStatic(self, target_frame: str, source_frame: str, transform: Matrix) -> ReturnValue:
        """Set the static pose of the target in the source; fails where they are connected already."""
        there = self._connected(target_frame, source_frame)
        return self._set(target_frame, source_frame, transform, there, static=True)

    def deleteTransform(self, target_frame: str, source_frame: str) -> ReturnValue:
        """Delete the transform between two frames, whichever is the parent; ``*`` stands for any frame."""
        return called(self.forget, target_frame, source_frame)

    def transformPoint(
        self, target_frame: str, source_frame: str, input_point: Vector, transformed_point: Vector
    ) -> ReturnValue:
        """A point that the target sees, as the source does; x, y, z."""
        if len(input_point) != 3:
            return ReturnValue(_FAILED)
        outcome, pose = self._asked(lambda tree: tree.pose(target_frame, source_frame))
        if outcome:
            _fill(transformed_point, pose[:3, :3] @ np.asarray(input_point) + pose[:3, 3])
        return outcome

    def transformPose(
        self, target_frame: str, source_frame: str, input_pose: Vector, transformed_pose: Vector
    ) -> ReturnValue:
        """A pose that the target sees, as the source does; x, y, z, roll, pitch, yaw."""
        if len(input_pose) != 6:
            return ReturnValue(_FAILED)
        outcome, pose = self._asked(lambda tree: tree.pose(target_frame, source_frame))
        if outcome:
            x, y, z, roll, pitch, yaw = np.asarray(input_pose, float).tolist()
            given = of_angles(roll, pitch, yaw)
            given[:3, 3] = x, y, z
            found = pose @ given
            _fill(transformed_pose, [*found[:3, 3].tolist(), *angles_of(found)])
        return outcome

    def transformQuaternion(
        self, target_frame: str, source_frame: str, input_quaternion: Quaternion, transformed_quaternion: Quaternion
    ) -> ReturnValue:
        """A rotation that the target sees, as the source does."""
        outcome, found = self._asked(
            lambda tree: tree.pose(target_frame, source_frame) @ input_quaternion.toRotationMatrix4x4().numpy()
        )
        if outcome:
            transformed_quaternion.fromRotationMatrix(found)
        return outcome

    def waitForTransform(self, target_frame: str, source_frame: str, timeout: float) -> ReturnValue:
        """Wait for a way between two frames; it fails after so many seconds."""
        known = self._connected(target_frame, source_frame)
        try:
            return ReturnValue(_OK if self.wait_until(known, timeout) else _FAILED)
        except (OSError, WireError):
            return ReturnValue(ReturnCode.COMMUNICATION)

    @staticmethod
    def _connected(one: str, other: str) -> Callable[[FrameTree], bool]:
        return lambda tree: tree.connected(one, other)

    def _asked(self, question: Question) -> tuple[ReturnValue, Any]:
        """The answer to a question about the frames; None where it has none."""
        try:
            return ReturnValue(_OK), question(self.tree())
        except (TransformError, ValueError):
            return ReturnValue(_FAILED), None
        except (OSError, WireError):
            return ReturnValue(ReturnCode.COMMUNICATION), None

    def _set(self, child: str, parent: str, transform: Matrix, wrong: Question, *, static: bool) -> ReturnValue:
        outcome, refused = self._asked(wrong)
        if child == parent or refused or not outcome:
            return _or_failed(outcome)
        try:
            made = transform_of(child, parent, transform, now(), static=static)
        except ValueError:
            return ReturnValue(_FAILED)
        return called(self.send, [made])


def _or_failed(outcome: ReturnValue) -> ReturnValue:
    return outcome if not outcome else ReturnValue(_FAILED)


def _fill(vector: Vector, values: Any) -> None:
    vector.resize(len(values))
    for place, value in enumerate(values):
        vector[place] = float(value)


def _words(transform: FrameTransform) -> str:
    """A transform as YARP prints it (`FrameTransform::toString`)."""
    t = transform
    return (
        f"{t.src_frame_id} -> {t.dst_frame_id} \n tran: {t.tX:f} {t.tY:f} {t.tZ:f} \n"
        f" rot quaternion: {t.qX:f} {t.qY:f} {t.qZ:f} {t.qW:f}\n\n"
    )
