"""What is asked of the buffer: poses, by the names of frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bridge.tf import reasons
from bridge.tf.errors import ConnectivityError, ExtrapolationError, InvalidArgumentError, LookupError_, TransformError
from bridge.tf.frames import Frames
from bridge.tf.history import History
from bridge.tf.layout import BOUND, CONNECTIVITY, DONE, LOOP, STAMP, TIMED, TROUBLE
from bridge.tf.transform import LATEST, Transform, Transforms


class Lookups:
    """Looks up transforms. Its user's lock is held during every call; names have no slash at their beginning.

    Attributes:
        loops: lookups that ended in a loop.

    Args:
        frames: the buffer's frames.
        history: their samples.
    """

    def __init__(self, frames: Frames, history: History) -> None:
        self.loops = 0
        self._history = history
        self._numbers, self._known = frames.numbers, frames.known

    def one(self, target: str, source: str, stamp: int, horizon: int) -> Transform:
        """The pose of the source in the target; ``horizon`` ns may be extrapolated."""
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

    def full(
        self, target: str, target_stamp: int, source: str, source_stamp: int, fixed: str, horizon: int
    ) -> Transform:
        """The pose that the source had at one time in the target at another, while the fixed frame did not move."""
        for name, role in ((target, "target"), (source, "source"), (fixed, "fixed")):
            self._number(name, role)
        first = self.one(fixed, source, source_stamp, horizon)
        then = self.one(target, fixed, target_stamp, horizon)
        x, y, z, qx, qy, qz, qw = self._history.compose(
            [*first.translation, *first.rotation], [*then.translation, *then.rotation]
        )
        return Transform(target, source, then.stamp, (x, y, z), (qx, qy, qz, qw))

    def many(
        self, target: str, source: str, times: NDArray[np.int64], fixed: str, target_stamp: int, horizon: int
    ) -> Transforms:
        """The poses of the source at many times (N, contiguous), which become those of the answers."""
        then = self.one(target, fixed, target_stamp, horizon) if fixed else None
        poses, answers = self._poses(fixed or target, source, times, horizon)
        if then is not None:
            self._history.compose_many(poses, [*then.translation, *then.rotation])
        return Transforms(times, poses[:, :3], poses[:, 3:], answers == DONE)

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
