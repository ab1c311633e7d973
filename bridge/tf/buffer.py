"""The transform buffer: histories of frames, and lookups by frame names."""

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
    """Stores the histories of frames, and returns transforms between any two frames at any time, as tf2's buffer does.

    Safe to use from any thread. Stamps are in ns. Leading slashes of names are ignored.

    Args:
        cache_time: seconds of history before each frame's newest transform.
        max_future: seconds that a stamp may be ahead of the clock (amcl and gmapping stamp ahead).
        now: returns the clock's time in ns; if it is None, stamps are not compared with a clock.
    """

    def __init__(
        self, cache_time: float = 10.0, *, max_future: float = 2.0, now: Callable[[], int] | None = None
    ) -> None:
        self._frames = FrameTable()
        self._history = TransformHistory(round(cache_time * _SECOND))
        self._intake = Intake(self._frames, self._history, round(max_future * _SECOND), now)
        self.refused = self._intake.refused  # number of refused transforms, by reason
        self.last_refused = self._intake.last_refused  # the last refusal of each reason, as text
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._waiting = 0
        self.changes = 0  # increases with every change that may affect lookups
        self.loops = 0  # lookups that failed because of a loop

    def set_transform(
        self,
        frame_id: str,  # the parent
        child_frame_id: str,  # the child; its first transform determines whether it is static, as in tf2
        stamp: int,  # ns; ignored if the child is static
        translation: Sequence[float],  # x, y, z in m
        rotation: Sequence[float],  # x, y, z, w
        authority: str = "",  # the publisher
        *,
        static: bool = False,  # valid at all times
    ) -> FrameRefusal | None:
        """Insert the pose of a child frame in its parent.

        Returns:
            None, or the reason why the transform was refused; refusals are also counted.

        Raises:
            TypeError, ValueError: stamp, translation or rotation are not numbers, or have the wrong length.
        """
        with self._lock:
            refusal = self._intake.set(frame_id, child_frame_id, stamp, translation, rotation, authority, static)
            if refusal is None:
                self._change()
        return refusal

    def set_transforms(
        self, samples: Iterable[Sample], authority: str = "", *, static: bool = False
    ) -> list[FrameRefusal | None]:
        """Insert many transforms at once, each as (parent, child, stamp, translation, rotation).

        Each is handled as in `set_transform`. Lookups see all of the transforms or none. But if a transform raises, the
        earlier ones stay inserted.
        """
        with self._lock:
            try:
                return self._intake.set_all(samples, authority, static)
            finally:
                self._change()

    @property
    def waiting(self) -> int:
        """Number of lookups that wait for their transforms."""
        return self._waiting

    def set_message(self, cdr: bytes, authority: str = "", *, static: bool = False) -> list[FrameRefusal | None]:
        """Insert a message of `/tf` or `/tf_static` directly from its bytes.

        Args:
            cdr: ``tf2_msgs/msg/TFMessage`` with its encapsulation header.
            authority: the publisher.
            static: whether it is from `/tf_static`.

        Returns:
            For each transform None, or the reason why it was refused.

        Raises:
            ValueError: the bytes are not a TFMessage.
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
        target_frame: str,  # frame to transform data to
        source_frame: str,  # frame that the data are in
        stamp: int = LATEST,  # ns, or `LATEST`
        *,
        timeout: float = 0.0,  # seconds to wait for the transform
        # seconds before and after each frame's history for which its motion is extrapolated
        extrapolate: float = 0.0,
    ) -> Transform:
        """Return the pose of the source frame in the target frame, which transforms data from the source to the target.

        Raises:
            LookupError_: a frame is unknown, or the frames form a loop.
            ConnectivityError: the frames are not connected.
            ExtrapolationError: the stamp is outside the known history.
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
        target_frame: str,  # frame to transform data to
        target_stamp: int,  # its time in ns, or `LATEST`
        source_frame: str,  # frame that the data are in
        source_stamp: int,  # its time in ns, or `LATEST`
        fixed_frame: str,  # the frame that does not move between the two times
        *,
        timeout: float = 0.0,  # as in `lookup_transform`, which also lists the exceptions
        extrapolate: float = 0.0,  # as in `lookup_transform`
    ) -> Transform:
        """Return the pose of the source frame at one time in the target frame at another time."""
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
        target_frame: str,  # frame to transform data to
        source_frame: str,  # frame that the data are in
        stamps: ArrayLike,  # (N), ns
        *,
        # if given, the target frame's pose in this frame at ``target_stamp`` is used for all stamps; otherwise its own
        # pose at each stamp
        fixed_frame: str = "",
        target_stamp: int = LATEST,  # ns, or `LATEST`
        extrapolate: float = 0.0,  # as in `lookup_transform`
    ) -> TransformsInTime:
        """Return the poses of the source frame at many times, to correct a scan that was measured in motion.

        Returns:
            The poses; a stamp without a known pose does not affect the others.

        Raises:
            LookupError_: a frame is unknown.
            TransformError: the fixed frame is unavailable at ``target_stamp``; see `lookup_transform`.
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
        """Return whether `lookup_transform` would succeed, and if not, why."""
        try:
            self.lookup_transform(target_frame, source_frame, stamp, timeout=timeout, extrapolate=extrapolate)
        except TransformError as err:
            return False, str(err)
        return True, ""

    def clear(self) -> None:
        """Remove the transforms of all frames except static ones, because the clock was set back."""
        with self._lock:
            self._history.clear()
            for frame in self._frames:
                if frame.kind == TIMED:
                    frame.forget_sources()
            self.changes += 1

    def remove(self, child_frame_id: str) -> bool:
        """Remove a frame's transforms, static or not; return whether it had any."""
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
        """Return information on each frame that has a parent, sorted by name."""
        with self._lock:
            return self._frames.infos(self._history)

    def conflicts(self) -> list[FrameInfo]:
        """Return the frames with more than one parent within the history; ``sources`` names the publishers."""
        return [info for info in self.frames() if len(info.parents) > 1]

    def tree(self) -> str:
        """Return the tree as text."""
        return tree.as_text(self.frames())

    def dot(self) -> str:
        """Return the tree as a Graphviz graph."""
        return tree.as_dot(self.frames())

    def yaml(self) -> str:
        """Return all frames in the format of the service ``tf2_frames``."""
        return tree.as_yaml(self.frames())

    def _pose(self, target: str, source: str, stamp: int, horizon: int) -> Transform:
        """Return the pose of the source in the target, extrapolated by up to ``horizon`` ns."""
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
        """Return the exception for a failed lookup; it has tf2's text, which users search for."""
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
        """Call ``ask``, and again whenever a transform arrives, until it succeeds or the timeout expires."""
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
