"""The transform buffer: histories of frames, and lookups in them by names."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.tf import errors, tree
from bridge.tf.errors import (
    ConnectivityError,
    ExtrapolationError,
    FrameRefusal,
    InvalidArgumentError,
    LookupError_,
    TransformError,
)
from bridge.tf.frames import FrameTable
from bridge.tf.history import TransformHistory, compose, compose_many
from bridge.tf.intake import Intake, Sample
from bridge.tf.layout import CONNECTIVITY, LOOP, NONE, TIMED
from bridge.tf.transform import LATEST, FrameInfo, Transform, TransformsInTime

_SECOND = 1_000_000_000


class TransformBuffer:
    """Histories of frames, and transforms between any two of them at any time in them, as tf2's buffer has.

    Safe to use from any thread. Stamps are in ns. Slashes that a name begins with are left out.

    Args:
        cache_time: seconds of history before each frame's newest transform.
        max_future: seconds that a stamp may be ahead of the clock (amcl and gmapping stamp ahead).
        now: the clock's time in ns; without it stamps are not held against any.
    """

    def __init__(
        self, cache_time: float = 10.0, *, max_future: float = 2.0, now: Callable[[], int] | None = None
    ) -> None:
        self._frames = FrameTable()
        self._history = TransformHistory(round(cache_time * _SECOND))
        self._intake = Intake(self._frames, self._history, round(max_future * _SECOND), now)
        self.refused = self._intake.refused  # how many transforms were not taken up, by why
        self.last_refused = self._intake.last_refused  # the last of each, in words
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._waiting = 0
        self.changes = 0  # grows whenever something was taken up or forgotten, so that a lookup may have another answer
        self.clears = 0
        self.loops = 0  # lookups that ended in a loop

    def set_transform(
        self,
        frame_id: str,  # the parent
        child_frame_id: str,  # the child. Whether it is static is said by its first transform, as in tf2.
        stamp: int,  # ns; not looked at where the child is static
        translation: Sequence[float],  # x, y, z in m
        rotation: Sequence[float],  # x, y, z, w
        authority: str = "",  # who says so
        *,
        static: bool = False,  # it holds for all times
    ) -> FrameRefusal | None:
        """Take up the pose of a child frame in its parent.

        Returns:
            None, or why it was not taken up, which is counted too.

        Raises:
            TypeError, ValueError: what was given are not numbers, or not as many.
        """
        with self._lock:
            refusal = self._intake.set(frame_id, child_frame_id, stamp, translation, rotation, authority, static)
            if refusal is None:
                self._change()
        return refusal

    def set_transforms(
        self, samples: Iterable[Sample], authority: str = "", *, static: bool = False
    ) -> list[FrameRefusal | None]:
        """Take up many transforms at once: each as (parent, child, stamp, translation, rotation).

        Lookups see all of them or none. For each of them `set_transform` says what is given and raised; what came
        before one that raises is taken up.
        """
        with self._lock:
            try:
                return self._intake.set_all(samples, authority, static)
            finally:
                self._change()

    @property
    def waiting(self) -> int:
        """Lookups that wait for what they need."""
        return self._waiting

    def set_message(self, cdr: bytes, authority: str = "", *, static: bool = False) -> list[FrameRefusal | None]:
        """Take up a message of `/tf` or `/tf_static`, straight from its bytes.

        Args:
            cdr: ``tf2_msgs/msg/TFMessage`` with its encapsulation header.
            authority: who says so.
            static: it is of `/tf_static`.

        Returns:
            For each transform None, or why it was not taken up.

        Raises:
            ValueError: the bytes are no such message.
        """
        with self._lock:
            refusals = self._intake.set_message(cdr, authority, static)
            self._change()
        return refusals

    def _change(self) -> None:
        self.changes += 1
        if self._waiting:
            self._changed.notify_all()

    def lookup_transform(
        self,
        target_frame: str,  # frame that data are wanted in
        source_frame: str,  # frame that they are in
        stamp: int = LATEST,  # ns, or `LATEST`
        *,
        timeout: float = 0.0,  # seconds to wait until there is one
        # seconds before and behind each frame's history for which it goes on moving as it did
        extrapolate: float = 0.0,
    ) -> Transform:
        """The pose of the source frame in the target frame, which takes data from the source to the target.

        Raises:
            LookupError_: a frame is not known, or there is a loop.
            ConnectivityError: there is no way between them.
            ExtrapolationError: the stamp is outside of what is known.
            InvalidArgumentError: a name is empty.
        """
        horizon = round(extrapolate * _SECOND)
        target, source = target_frame.lstrip("/"), source_frame.lstrip("/")
        with self._lock:
            if timeout > 0.0:
                return self._wait(timeout, lambda: self._pose(target, source, stamp, horizon))
            return self._pose(target, source, stamp, horizon)

    def lookup_transform_full(
        self,
        target_frame: str,  # frame that data are wanted in
        target_stamp: int,  # its time in ns, or `LATEST`
        source_frame: str,  # frame that they are in
        source_stamp: int,  # its time
        fixed_frame: str,  # the frame that does not move between the two
        *,
        timeout: float = 0.0,  # as in `lookup_transform`, which says what is raised too
        extrapolate: float = 0.0,  # as there
    ) -> Transform:
        """The pose that the source frame had at one time in the target frame at another."""
        horizon = round(extrapolate * _SECOND)
        target, source, fixed = (name.lstrip("/") for name in (target_frame, source_frame, fixed_frame))

        def ask() -> Transform:
            for name, role in ((target, "target"), (source, "source"), (fixed, "fixed")):
                self._number(name, role)
            first = self._pose(fixed, source, source_stamp, horizon)
            then = self._pose(target, fixed, target_stamp, horizon)
            pose = compose(first.translation, first.rotation, then.translation, then.rotation)
            return Transform(target, source, then.stamp, *pose)

        with self._lock:
            return self._wait(timeout, ask)

    def lookup_many(
        self,
        target_frame: str,  # frame that data are wanted in
        source_frame: str,  # frame that they are in
        stamps: ArrayLike,  # (N), ns
        *,
        # where given, the target frame is where it was in this frame at ``target_stamp``; else it moves on with the
        # stamps
        fixed_frame: str = "",
        target_stamp: int = LATEST,  # ns, or `LATEST`
        extrapolate: float = 0.0,  # as in `lookup_transform`
    ) -> TransformsInTime:
        """The poses of the source frame at many times, for the correction of a scan that was taken on the move.

        Returns:
            The poses; a stamp without one does not spoil the others.

        Raises:
            LookupError_: a frame is not known.
            TransformError: there is no fixed frame at ``target_stamp``: as `lookup_transform` says.
        """
        horizon = round(extrapolate * _SECOND)
        target, source, fixed = (name.lstrip("/") for name in (target_frame, source_frame, fixed_frame))
        times: NDArray[np.int64] = np.array(stamps, np.int64, ndmin=1, order="C").ravel()
        with self._lock:
            then = self._pose(target, fixed, target_stamp, horizon) if fixed else None
            poses, known = self._poses(fixed or target, source, times, horizon)
            if then is not None:
                compose_many(poses, then.translation, then.rotation)
        return TransformsInTime(times, poses[:, :3], poses[:, 3:], known)

    def can_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp: int = LATEST,
        *,
        timeout: float = 0.0,
        extrapolate: float = 0.0,
    ) -> tuple[bool, str]:
        """Whether `lookup_transform` would have an answer, and why not."""
        try:
            self.lookup_transform(target_frame, source_frame, stamp, timeout=timeout, extrapolate=extrapolate)
        except TransformError as err:
            return False, str(err)
        return True, ""

    def can_transform_full(
        self,
        target_frame: str,
        target_stamp: int,
        source_frame: str,
        source_stamp: int,
        fixed_frame: str,
        *,
        timeout: float = 0.0,
        extrapolate: float = 0.0,
    ) -> tuple[bool, str]:
        """Whether `lookup_transform_full` would have an answer, and why not."""
        try:
            self.lookup_transform_full(
                target_frame,
                target_stamp,
                source_frame,
                source_stamp,
                fixed_frame,
                timeout=timeout,
                extrapolate=extrapolate,
            )
        except TransformError as err:
            return False, str(err)
        return True, ""

    def clear(self) -> None:
        """Forget all but static frames: for a clock that was set back."""
        with self._lock:
            self._history.clear()
            for frame in self._frames:
                if frame.kind == TIMED:
                    frame.forget_sources()
            self.clears += 1
            self.changes += 1

    def remove(self, child_frame_id: str) -> bool:
        """Forget a frame's transforms, static or not; whether it had any."""
        with self._lock:
            frame = self._frames.known.pop(child_frame_id.lstrip("/"), None)
            if frame is None:
                return False
            frame.forget_sources()
            frame.kind = NONE
            self._history.remove(frame.number)
            self.changes += 1
            return True

    def frames(self) -> list[FrameInfo]:
        """What is known of each frame that has a parent, by name."""
        with self._lock:
            return self._frames.infos(self._history)

    def conflicts(self) -> list[FrameInfo]:
        """The frames that had more than one parent within the history: see their sources."""
        return [info for info in self.frames() if len(info.parents) > 1]

    def tree(self) -> str:
        """The tree as text."""
        return tree.as_text(self.frames())

    def dot(self) -> str:
        """The tree for Graphviz."""
        return tree.as_dot(self.frames())

    def yaml(self) -> str:
        """All frames as tf2 tells them (service ``tf2_frames``)."""
        return tree.as_yaml(self.frames())

    def _pose(self, target: str, source: str, stamp: int, horizon: int) -> Transform:
        """The pose of the source in the target; ``horizon`` ns may be extrapolated."""
        if target == source:
            return self._identity(target, stamp)
        try:
            target_number, source_number = self._frames.numbers[target], self._frames.numbers[source]
        except KeyError:
            target_number, source_number = self._number(target, "target"), self._number(source, "source")
        result = self._history.lookup(target_number, source_number, stamp, horizon)
        if result is None:
            raise self._error(target, source)
        translation, rotation, stamp = result
        return Transform(target, source, stamp, translation, rotation)

    def _identity(self, name: str, stamp: int) -> Transform:
        frame = self._frames.known.get(name)
        if stamp == LATEST and frame is not None and frame.kind == TIMED:
            stamp = self._history.newest(frame.number)[1]
        return Transform(name, name, stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))

    def _number(self, name: str, role: str) -> int:
        if not name:
            raise InvalidArgumentError(errors.empty_name(role))
        number = self._frames.numbers.get(name)
        if number is None:
            raise LookupError_(errors.unknown_name(name, role))
        return number

    def _error(self, target: str, source: str) -> TransformError:
        """The error of a lookup, in tf2's words, which people search for."""
        answer, stamp, bound, trouble = self._history.failure()
        if answer == LOOP:
            self.loops += 1
            return LookupError_(errors.LOOP)
        if answer == CONNECTIVITY:
            return ConnectivityError(errors.connectivity(target, source))
        return ExtrapolationError(errors.extrapolation(stamp, bound, trouble, target, source))

    def _poses(
        self, target: str, source: str, times: NDArray[np.int64], horizon: int
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        target_number, source_number = self._number(target, "target"), self._number(source, "source")
        if target_number == source_number:
            return np.tile([0.0] * 6 + [1.0], (len(times), 1)), np.ones(len(times), np.bool_)
        return self._history.lookup_many(target_number, source_number, times, horizon)

    def _wait(self, timeout: float, ask: Callable[[], Transform]) -> Transform:
        """Ask again whenever something new has come, up to the deadline."""
        end = time.monotonic() + timeout
        while True:
            try:
                return ask()
            except InvalidArgumentError:
                raise
            except TransformError:
                left = end - time.monotonic()
                if left <= 0:
                    raise
            self._waiting += 1
            try:
                self._changed.wait(left)
            finally:
                self._waiting -= 1
