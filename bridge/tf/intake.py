"""Inserts new transforms into the buffer, or refuses them with the reason."""

from __future__ import annotations

import logging
import operator
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

from bridge.tf import errors, message
from bridge.tf.errors import FrameRefusal
from bridge.tf.frames import MAX_FRAMES, Frame, FrameTable
from bridge.tf.history import TransformHistory, pose_flaw
from bridge.tf.layout import DENORMALIZED, DONE, LAST_STAMP, NAN, NONE, OLD, REPEATED, STATIC, TIMED

_log = logging.getLogger(__name__)
_SECOND = 1_000_000_000
_MAX_LINKS = 4 * MAX_FRAMES
_REFUSALS = {
    NAN: FrameRefusal.NAN_INPUT,
    DENORMALIZED: FrameRefusal.DENORMALIZED_QUATERNION,
    OLD: FrameRefusal.OLD_DATA,
    REPEATED: FrameRefusal.REPEATED_DATA,
}

Sample = tuple[str, str, int, Sequence[float], Sequence[float]]
"""Parent, child, stamp in ns, translation in m, rotation (x, y, z, w)."""

OTHER_SCALE = 86_400 * _SECOND
"""A stamp that differs from the clock by a day (in ns) is on another time scale, such as simulated time."""


class Intake:
    """Inserts transforms. Not thread-safe: the caller must hold a lock during every call.

    Args:
        max_future: ns that a stamp may be ahead of the clock.
        now: returns the clock's time in ns; None without a clock.
    """

    def __init__(
        self, frames: FrameTable, history: TransformHistory, max_future: int, now: Callable[[], int] | None
    ) -> None:
        self.refused: Counter[FrameRefusal] = Counter()
        self.last_refused: dict[FrameRefusal, str] = {}
        self._frames, self._history = frames, history
        self._numbers, self._known = frames.numbers, frames.known
        self._max_future, self._now = max_future, now
        self._links: dict[bytes, tuple[Frame, int]] = {}  # the frame and its parent by the bytes of their names

    def set(
        self,
        parent_name: str,
        child_name: str,
        stamp: int,
        translation: Sequence[float],
        rotation: Sequence[float],
        authority: str,
        static: bool,
    ) -> FrameRefusal | None:
        """Store one transform; see `bridge.tf.buffer.TransformBuffer.set_transform`."""
        x, y, z = translation
        qx, qy, qz, qw = rotation
        if type(stamp) is not int:
            stamp = operator.index(stamp)
        pose = (x, y, z, qx, qy, qz, qw)
        frame = self._known.get(child_name)
        parent = self._numbers.get(parent_name)
        if frame is None or parent is None or parent == frame.number:
            begun = self._begin(parent_name.lstrip("/"), child_name.lstrip("/"), stamp, pose, static)
            if isinstance(begun, FrameRefusal):
                return self._refuse(begun, parent_name, child_name, stamp, authority)
            frame, parent = begun
        refusal = self._stamp_flaw(frame, stamp, static)
        if refusal is None:
            refusal = self._record(
                self._history.insert(frame.number, parent, stamp, pose), frame, parent, stamp, authority
            )
        return None if refusal is None else self._refuse(refusal, parent_name, child_name, stamp, authority)

    def set_all(self, samples: Iterable[Sample], authority: str, static: bool) -> list[FrameRefusal | None]:
        """Store transforms; see `bridge.tf.buffer.TransformBuffer.set_transforms`."""
        return [self.set(*sample, authority, static) for sample in samples]

    def set_message(self, cdr: bytes, authority: str, static: bool) -> list[FrameRefusal | None]:
        """Store the transforms of a message; see `bridge.tf.buffer.TransformBuffer.set_message`."""
        answers: list[FrameRefusal | None] = []
        links = self._links
        for stamp, names, at in message.read(cdr):
            link = links.get(names)
            if link is None or link[0].kind == NONE:
                pair = message.split_names(names)
                pose = struct.unpack_from("<7d", cdr, at)
                answers.append(self.set(*pair, stamp, pose[:3], pose[3:], authority, static))
                self._link(names, *pair)
                continue
            frame, parent = link
            refusal = self._stamp_flaw(frame, stamp, static)
            if refusal is None:
                answer = self._history.insert_at(frame.number, parent, stamp, cdr, at)
                refusal = self._record(answer, frame, parent, stamp, authority)
            if refusal is not None:
                self._refuse(refusal, self._frames[parent].name, frame.name, stamp, authority)
            answers.append(refusal)
        return answers

    def _link(self, names: bytes, parent_name: str, child_name: str) -> None:
        """Store the two frames under the bytes of their names, if both are known by now."""
        parent = self._numbers.get(parent_name.lstrip("/"))
        frame = self._known.get(child_name.lstrip("/"))
        if frame is not None and parent is not None and parent != frame.number:
            if len(self._links) >= _MAX_LINKS:
                self._links.clear()
            self._links[names] = frame, parent

    def _begin(
        self, parent: str, child: str, stamp: int, pose: tuple[float, ...], static: bool
    ) -> tuple[Frame, int] | FrameRefusal:
        """Return child and parent of a transform with new frames or leading slashes, or why it is refused."""
        if flaw := self._names_flaw(parent, child, pose):
            return flaw
        frame = self._known.get(child)
        if frame is None:
            if not static and (stamp_flaw := self._clock_flaw(stamp)):
                return stamp_flaw
            frame = self._frames.get(child)
        above = self._frames.get(parent).number
        self._history.make_room(max(frame.number, above))
        if frame.kind == NONE:
            self._history.begin(frame.number, static=static)
            frame.kind = STATIC if static else TIMED
            self._known[child] = frame
        return frame, above

    def _names_flaw(self, parent: str, child: str, pose: tuple[float, ...]) -> FrameRefusal | None:
        """Apply tf2's checks for new frames."""
        if not child:
            return FrameRefusal.NO_CHILD_FRAME_ID
        if not parent:
            return FrameRefusal.NO_FRAME_ID
        if parent == child:
            return FrameRefusal.SELF_TRANSFORM
        if self._frames.full and not {parent, child} <= self._numbers.keys():
            return FrameRefusal.TOO_MANY_FRAMES
        return _REFUSALS.get(pose_flaw(*pose))

    def _stamp_flaw(self, frame: Frame, stamp: int, static: bool) -> FrameRefusal | None:
        """Check the stamp of a known frame's transform, except that of a static transform whose frame is static."""
        if self._now is None and 0 <= stamp < LAST_STAMP:
            return None
        return None if static and frame.kind != TIMED else self._clock_flaw(stamp)

    def _clock_flaw(self, stamp: int) -> FrameRefusal | None:
        if not 0 <= stamp < LAST_STAMP:
            return FrameRefusal.INVALID_STAMP
        if self._now is None:
            return None
        ahead = stamp - self._now()
        if -OTHER_SCALE < ahead <= self._max_future:
            return None
        return FrameRefusal.FUTURE if 0 < ahead < OTHER_SCALE else FrameRefusal.TIME_SCALE

    def _record(self, answer: int, frame: Frame, parent: int, stamp: int, authority: str) -> FrameRefusal | None:
        """Store the source of an inserted transform, or return why the history refused it."""
        if answer != DONE:
            return _REFUSALS[answer]
        if frame.parent != parent or frame.authority != authority:
            frame.switch(parent, authority)
        frame.stamp = stamp
        return None

    def _refuse(self, reason: FrameRefusal, parent: str, child: str, stamp: int, authority: str) -> FrameRefusal:
        self.refused[reason] += 1
        message_ = errors.refusal(reason, parent, child, stamp, authority)
        self.last_refused[reason] = message_
        if self.refused[reason] == 1:  # the rest are only counted: a publisher may send hundreds a second
            _log.warning("%s (more of these are only counted)", message_)
        return reason
