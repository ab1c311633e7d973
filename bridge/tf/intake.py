"""What is told to the buffer: taken up, or refused with the reason."""

from __future__ import annotations

import logging
import operator
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

from bridge.tf import kernels, reasons
from bridge.tf.errors import Refusal
from bridge.tf.frames import MAX_FRAMES, Frame, Frames
from bridge.tf.history import History
from bridge.tf.layout import DENORMALIZED, DONE, NAN, NONE, OLD, POSE, REPEATED, STATIC, TIMED
from bridge.tf.message import MessageReader

_log = logging.getLogger(__name__)
_SECOND = 1_000_000_000
_LAST_STAMP = 1 << 62
_MAX_LINKS = 4 * MAX_FRAMES
_REFUSALS = {
    NAN: Refusal.NAN_INPUT,
    DENORMALIZED: Refusal.DENORMALIZED_QUATERNION,
    OLD: Refusal.OLD_DATA,
    REPEATED: Refusal.REPEATED_DATA,
}

Sample = tuple[str, str, int, Sequence[float], Sequence[float]]
"""Parent, child, stamp in ns, translation in m, rotation (x, y, z, w)."""

OTHER_SCALE = 86_400 * _SECOND
"""A stamp that is a day from the clock's time is of another time scale: a simulation's beside the machine's."""


class Intake:
    """Takes up transforms. Its user's lock is held during every call.

    Args:
        frames: the buffer's frames.
        history: their samples.
        max_future: ns that a stamp may be ahead of the clock.
        now: the clock's time in ns, if there is one.
    """

    def __init__(self, frames: Frames, history: History, max_future: int, now: Callable[[], int] | None) -> None:
        self.refused: Counter[Refusal] = Counter()
        self.last_refused: dict[Refusal, str] = {}
        self._frames, self._history = frames, history
        self._numbers, self._known = frames.numbers, frames.known
        self._max_future, self._now = max_future, now
        self._reader = MessageReader()
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
    ) -> Refusal | None:
        """`bridge.tf.buffer.TransformBuffer.set_transform`."""
        x, y, z = translation
        qx, qy, qz, qw = rotation
        if type(stamp) is not int:
            stamp = operator.index(stamp)
        pose = (x, y, z, qx, qy, qz, qw)
        frame = self._known.get(child_name)
        parent = self._numbers.get(parent_name)
        if frame is None or parent is None or parent == frame.number:
            begun = self._begin(parent_name.lstrip("/"), child_name.lstrip("/"), stamp, pose, static)
            if isinstance(begun, Refusal):
                return self._refuse(begun, parent_name, child_name, stamp, authority)
            frame, parent = begun
        refusal = self._late(frame, stamp, static)
        if refusal is None:
            refusal = self._took(
                self._history.insert(frame.number, parent, stamp, pose), frame, parent, stamp, authority
            )
        return None if refusal is None else self._refuse(refusal, parent_name, child_name, stamp, authority)

    def set_all(self, samples: Iterable[Sample], authority: str, static: bool) -> list[Refusal | None]:
        """`bridge.tf.buffer.TransformBuffer.set_transforms`."""
        return [self.set(*sample, authority, static) for sample in samples]

    def set_message(self, cdr: bytes, authority: str, static: bool) -> list[Refusal | None]:
        """`bridge.tf.buffer.TransformBuffer.set_message`."""
        answers: list[Refusal | None] = []
        reader, links = self._reader, self._links
        for number, (stamp, begin, parent_end, child, end) in enumerate(reader.read(cdr)):
            names = cdr[begin:end]
            link = links.get(names)
            if link is None or link[0].kind == NONE:
                pair = str(cdr[begin:parent_end], "utf-8", "replace"), str(cdr[child:end], "utf-8", "replace")
                pose = reader.poses[number].tolist()
                answers.append(self.set(*pair, stamp, pose[:3], pose[3:], authority, static))
                self._link(names, *pair)
                continue
            frame, parent = link
            refusal = self._late(frame, stamp, static)
            if refusal is None:
                answer = self._history.insert_at(frame.number, parent, stamp, reader.address + 8 * POSE * number)
                refusal = self._took(answer, frame, parent, stamp, authority)
            if refusal is not None:
                self._refuse(refusal, self._frames[parent].name, frame.name, stamp, authority)
            answers.append(refusal)
        return answers

    def _link(self, names: bytes, parent_name: str, child_name: str) -> None:
        """Remember the frames that these bytes name, where they are known by now."""
        parent = self._numbers.get(parent_name.lstrip("/"))
        frame = self._known.get(child_name.lstrip("/"))
        if frame is not None and parent is not None and parent != frame.number:
            if len(self._links) >= _MAX_LINKS:
                self._links.clear()
            self._links[names] = frame, parent

    def _begin(
        self, parent: str, child: str, stamp: int, pose: tuple[float, ...], static: bool
    ) -> tuple[Frame, int] | Refusal:
        """The frames of a transform that may be new, or whose names were not in their normal form."""
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
        return frame, above

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

    def _late(self, frame: Frame, stamp: int, static: bool) -> Refusal | None:
        """What is wrong with the stamp of a known frame's transform; where it is static, nobody looks at it."""
        if self._now is None and 0 <= stamp < _LAST_STAMP:
            return None
        return None if static and frame.kind != TIMED else self._untimely(stamp)

    def _untimely(self, stamp: int) -> Refusal | None:
        if not 0 <= stamp < _LAST_STAMP:
            return Refusal.INVALID_STAMP
        if self._now is None:
            return None
        ahead = stamp - self._now()
        if -OTHER_SCALE < ahead <= self._max_future:
            return None
        return Refusal.FUTURE if 0 < ahead < OTHER_SCALE else Refusal.TIME_SCALE

    def _took(self, answer: int, frame: Frame, parent: int, stamp: int, authority: str) -> Refusal | None:
        """Note who said it, where the history took it."""
        if answer != DONE:
            return _REFUSALS[answer]
        if frame.parent != parent or frame.authority != authority:
            frame.switch(parent, authority)
        frame.stamp = stamp
        return None

    def _refuse(self, why: Refusal, parent: str, child: str, stamp: int, authority: str) -> Refusal:
        self.refused[why] += 1
        told = reasons.refusal(why, parent, child, stamp, authority)
        self.last_refused[why] = told
        if self.refused[why] == 1:  # more of a kind are counted only: a publisher may send a hundred a second
            _log.warning("%s (more of these are only counted)", told)
        return why
