"""The transform buffer: who asks and who tells, by names."""

from __future__ import annotations

import logging
import operator
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.tf import kernels, reasons, tree
from bridge.tf.errors import (
    ConnectivityError,
    ExtrapolationError,
    InvalidArgumentError,
    LookupError_,
    Refusal,
    TransformError,
)
from bridge.tf.frames import Frame, Frames
from bridge.tf.history import History
from bridge.tf.layout import (
    BOUND,
    CONNECTIVITY,
    DENORMALIZED,
    DONE,
    LOOP,
    NAN,
    NONE,
    OLD,
    REPEATED,
    STAMP,
    STATIC,
    TIMED,
    TROUBLE,
)
from bridge.tf.transform import LATEST, FrameInfo, Transform, Transforms

_log = logging.getLogger(__name__)
_SECOND = 1_000_000_000
_LAST_STAMP = 1 << 62
_REFUSALS = {
    NAN: Refusal.NAN_INPUT,
    DENORMALIZED: Refusal.DENORMALIZED_QUATERNION,
    OLD: Refusal.OLD_DATA,
    REPEATED: Refusal.REPEATED_DATA,
}

OTHER_SCALE = 86_400 * _SECOND
"""A stamp that is a day from the clock's time is of another time scale: a simulation's beside the machine's."""


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
        self._frames = Frames()
        self._numbers = self._frames.numbers
        self._known: dict[str, Frame] = {}  # those that have transforms, or had and were cleared
        self._history = History(round(cache_time * _SECOND))
        self._max_future = round(max_future * _SECOND)
        self._now = now
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._waiting = 0
        self.refused: Counter[Refusal] = Counter()
        """How many transforms were not taken up, by why."""
        self.last_refused: dict[Refusal, str] = {}
        """The last of each, in words."""
        self.loops = 0
        """Lookups that ended in a loop."""
        self.clears = 0

    def set_transform(
        self,
        frame_id: str,
        child_frame_id: str,
        stamp: int,
        translation: Sequence[float],
        rotation: Sequence[float],
        authority: str = "",
        *,
        static: bool = False,
    ) -> Refusal | None:
        """Take up the pose of a child frame in its parent.

        Args:
            frame_id: the parent.
            child_frame_id: the child. Whether it is static is said by its first transform, as in tf2.
            stamp: ns; not looked at where the child is static.
            translation: x, y, z in m.
            rotation: x, y, z, w.
            authority: who says so.
            static: it holds for all times.

        Returns:
            None, or why it was not taken up, which is counted too.

        Raises:
            TypeError, ValueError: what was given are not numbers, or not as many.
        """
        x, y, z = translation
        qx, qy, qz, qw = rotation
        if type(stamp) is not int:
            stamp = operator.index(stamp)
        pose = (x, y, z, qx, qy, qz, qw)
        with self._lock:
            frame = self._known.get(child_frame_id)
            parent = self._numbers.get(frame_id)
            if frame is None or parent is None or parent == frame.number:
                refusal = self._begin(frame_id.lstrip("/"), child_frame_id.lstrip("/"), stamp, pose, authority, static)
            else:
                refusal = self._insert(frame, parent, stamp, pose, authority, static)
            if refusal is not None:
                self._refuse(refusal, frame_id, child_frame_id, stamp, authority)
            elif self._waiting:
                self._changed.notify_all()
        return refusal

    def _begin(
        self, parent: str, child: str, stamp: int, pose: tuple[float, ...], authority: str, static: bool
    ) -> Refusal | None:
        """Take up a transform of frames that may be new, or whose names are not in their normal form."""
        if wrong := self._wrong(parent, child, pose):
            return wrong
        frame = self._known.get(child)
        if frame is None:
            if not static and (late := self._untimely(stamp)):
                return late
            frame = self._frames.get(child)
        above = self._frames.get(parent).number
        self._history.make_room(max(frame.number, above))
        if frame.kind == NONE:
            self._history.begin(frame.number, static=static)
            frame.kind = STATIC if static else TIMED
            self._known[child] = frame
        return self._insert(frame, above, stamp, pose, authority, static)

    def _insert(
        self, frame: Frame, parent: int, stamp: int, pose: tuple[float, ...], authority: str, static: bool
    ) -> Refusal | None:
        if (
            (self._now is not None or not 0 <= stamp < _LAST_STAMP)
            and (not static or frame.kind == TIMED)
            and (late := self._untimely(stamp))
        ):
            return late
        answer = self._history.insert(frame.number, parent, stamp, pose)
        if answer != DONE:
            return _REFUSALS[answer]
        if frame.parent != parent or frame.authority != authority:
            frame.switch(parent, authority)
        frame.stamp = stamp
        return None

    def _wrong(self, parent: str, child: str, pose: tuple[float, ...]) -> Refusal | None:
        """What tf2 looks at before it gives new frames a number."""
        if not child:
            return Refusal.NO_CHILD_FRAME_ID
        if not parent:
            return Refusal.NO_FRAME_ID
        if parent == child:
            return Refusal.SELF_TRANSFORM
        if self._frames.full and not {parent, child} <= self._numbers.keys():
            return Refusal.TOO_MANY_FRAMES
        return _REFUSALS.get(kernels.pose_flaw(*pose))

    def _untimely(self, stamp: int) -> Refusal | None:
        if not 0 <= stamp < _LAST_STAMP:
            return Refusal.INVALID_STAMP
        if self._now is None:
            return None
        ahead = stamp - self._now()
        if -OTHER_SCALE < ahead <= self._max_future:
            return None
        return Refusal.FUTURE if 0 < ahead < OTHER_SCALE else Refusal.TIME_SCALE

    def _refuse(self, why: Refusal, parent: str, child: str, stamp: int, authority: str) -> None:
        self.refused[why] += 1
        told = reasons.refusal(why, parent, child, stamp, authority)
        self.last_refused[why] = told
        if self.refused[why] == 1:  # more of a kind are counted only: a publisher may send a hundred a second
            _log.warning("%s (more of these are only counted)", told)

    def lookup_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp: int = LATEST,
        *,
        timeout: float = 0.0,
        extrapolate: float = 0.0,
    ) -> Transform:
        """The pose of the source frame in the target frame, which takes data from the source to the target.

        Args:
            target_frame: frame that data are wanted in.
            source_frame: frame that they are in.
            stamp: ns, or `LATEST`.
            timeout: seconds to wait until there is one.
            extrapolate: seconds before and behind each frame's history for which it goes on moving as it did.

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
                return self._wait(timeout, lambda: self._lookup(target, source, stamp, horizon))
            return self._lookup(target, source, stamp, horizon)

    def lookup_transform_full(
        self,
        target_frame: str,
        target_stamp: int,
        source_frame: str,
        source_stamp: int,
        fixed_frame: str,
        *,
        timeout: float = 0.0,
        extrapolate: float = 0.0,
    ) -> Transform:
        """The pose that the source frame had at one time in the target frame at another.

        Args:
            target_frame: frame that data are wanted in.
            target_stamp: its time in ns, or `LATEST`.
            source_frame: frame that they are in.
            source_stamp: its time.
            fixed_frame: the frame that does not move between the two.
            timeout: as in `lookup_transform`, which says what is raised too.
            extrapolate: as there.
        """
        horizon = round(extrapolate * _SECOND)
        target, source, fixed = (name.lstrip("/") for name in (target_frame, source_frame, fixed_frame))

        def both() -> Transform:
            for name, role in ((target, "target"), (source, "source"), (fixed, "fixed")):
                self._number(name, role)
            first = self._lookup(fixed, source, source_stamp, horizon)
            then = self._lookup(target, fixed, target_stamp, horizon)
            x, y, z, qx, qy, qz, qw = self._history.compose(
                [*first.translation, *first.rotation], [*then.translation, *then.rotation]
            )
            return Transform(target, source, then.stamp, (x, y, z), (qx, qy, qz, qw))

        with self._lock:
            return self._wait(timeout, both)

    def lookup_many(
        self,
        target_frame: str,
        source_frame: str,
        stamps: ArrayLike,
        *,
        fixed_frame: str = "",
        target_stamp: int = LATEST,
        extrapolate: float = 0.0,
    ) -> Transforms:
        """The poses of the source frame at many times, for the correction of a scan that was taken on the move.

        Args:
            target_frame: frame that data are wanted in.
            source_frame: frame that they are in.
            stamps: (N), ns.
            fixed_frame: where given, the target frame is where it was in this frame at ``target_stamp``; else it
                moves on with the stamps.
            target_stamp: ns, or `LATEST`.
            extrapolate: as in `lookup_transform`.

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
            then = self._lookup(target, fixed, target_stamp, horizon) if fixed else None
            poses, answers = self._poses(fixed or target, source, times, horizon)
            if then is not None:
                self._history.compose_many(poses, [*then.translation, *then.rotation])
        return Transforms(times, poses[:, :3], poses[:, 3:], answers == DONE)

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

    def remove(self, child_frame_id: str) -> bool:
        """Forget a frame's transforms, static or not; whether it had any."""
        with self._lock:
            frame = self._known.pop(child_frame_id.lstrip("/"), None)
            if frame is None:
                return False
            frame.forget_sources()
            frame.kind = NONE
            self._history.forget(frame.number)
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

    def _lookup(self, target: str, source: str, stamp: int, horizon: int) -> Transform:
        if target == source:
            return self._identity(target, stamp)
        try:
            one, two = self._numbers[target], self._numbers[source]
        except KeyError:
            one, two = self._number(target, "target"), self._number(source, "source")
        history = self._history
        answer = history.lookup(one, two, stamp, horizon)
        if answer != DONE:
            raise self._error(answer, target, source)
        x, y, z, qx, qy, qz, qw = history.pose()
        if stamp == LATEST:
            stamp = history.facts()[STAMP]
        return Transform(target, source, stamp, (x, y, z), (qx, qy, qz, qw))

    def _poses(
        self, target: str, source: str, times: NDArray[np.int64], horizon: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        one, two = self._number(target, "target"), self._number(source, "source")
        if one == two:
            return np.tile([0.0] * 6 + [1.0], (len(times), 1)), np.full(len(times), DONE)
        return self._history.lookup_many(one, two, times, horizon)

    def _identity(self, name: str, stamp: int) -> Transform:
        frame = self._known.get(name)
        if stamp == LATEST and frame is not None and frame.kind == TIMED:
            stamp = self._history.newest(frame.number)[1]
        return Transform(name, name, stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))

    def _number(self, name: str, role: str) -> int:
        if not name:
            raise InvalidArgumentError(reasons.empty_name(role))
        number = self._numbers.get(name)
        if number is None:
            raise LookupError_(reasons.unknown_name(name, role))
        return number

    def _error(self, answer: int, target: str, source: str) -> TransformError:
        """The error of a lookup, in tf2's words, which people search for."""
        if answer == LOOP:
            self.loops += 1
            return LookupError_(reasons.LOOP)
        if answer == CONNECTIVITY:
            return ConnectivityError(reasons.connectivity(target, source))
        facts = self._history.facts()
        return ExtrapolationError(reasons.extrapolation(facts[STAMP], facts[BOUND], facts[TROUBLE], target, source))
