"""The frames as YARP programs see them: each with one parent, expiring by stamp, never in a loop."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace

from bridge.tf.stamped import Stamped
from yarp_compat.dev.frametransform import FrameTransform

ANY = "*"
"""The name that stands for every frame where transforms are deleted."""

_PATIENCE = 1.25
"""By how much longer a frame of the hub is shown than its lifetime: one sent just that often is late now and then."""


class Entry:
    """One frame.

    Attributes:
        transform: what YARP programs get.
        parent: its parent's name without the slash that YARP programs may write.
        stamp: ns of the run's clock.
        until: YARP's time from which on it is not shown.
        ours: a YARP program set it; else it is told on the hub, and its publishers own it.
    """

    __slots__ = ("ours", "parent", "stamp", "transform", "until")

    def __init__(self, transform: FrameTransform, parent: str, stamp: int, until: float, *, ours: bool) -> None:
        self.transform, self.parent, self.stamp, self.until, self.ours = transform, parent, stamp, until, ours


class View:
    """What YARP's server of transforms would hold. Its user's lock is held during every call.

    YARP's clients drop what they got by its stamp (0.2 s), and never end where frames form a loop; so frames of the hub
    are stamped anew whenever they are given, and what would close a loop is left out.

    Args:
        now: YARP's time in seconds.
        yarp_lifetime: seconds after its stamp for which a frame of a YARP program is shown.
        ros_lifetime: seconds after it was heard for which one of the hub is.
    """

    def __init__(self, now: Callable[[], float], yarp_lifetime: float, ros_lifetime: float) -> None:
        self._now = now
        self.yarp_lifetime, self.ros_lifetime = yarp_lifetime, ros_lifetime
        self._entries: dict[str, Entry] = {}
        self._spelled: dict[str, str] = {}
        self.left_out: Counter[str] = Counter()
        """Transforms that are not shown, by why."""

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def ours(self) -> int:
        """How many of the frames YARP programs set."""
        return sum(entry.ours for entry in self._entries.values())

    def is_static(self, child: str) -> bool:
        """Whether a frame that a YARP program set is static."""
        entry = self._entries.get(child)
        return entry is not None and entry.ours and bool(entry.transform.isStatic)

    def spell(self, name: str) -> None:
        """Remember how the first YARP program that sets a frame writes its name: it finds it in no other spelling."""
        plain = name.lstrip("/")
        if plain in self._spelled:
            return
        self._spelled[plain] = name
        if plain != name:
            for child, entry in self._entries.items():
                if plain in (child, entry.parent):
                    parent, child = self._spelled.get(entry.parent, entry.parent), self._spelled.get(child, child)
                    entry.transform = replace(entry.transform, src_frame_id=parent, dst_frame_id=child)

    def set(self, transform: FrameTransform, told: Stamped) -> None:
        """Show a frame that a YARP program set, as it wrote it and as the hub was told."""
        until = math.inf if transform.isStatic else transform.timestamp + self.yarp_lifetime
        self._show(told.child_frame_id, Entry(transform, told.frame_id, told.stamp, until, ours=True))

    def hear(self, told: Stamped, *, static: bool) -> None:
        """Show a frame of the hub; a static one does not expire."""
        parent, child = told.frame_id.lstrip("/"), told.child_frame_id.lstrip("/")
        until = math.inf if static else self._now() + _PATIENCE * self.ros_lifetime
        spelled = self._spelled.get
        names = spelled(parent, parent), spelled(child, child)
        transform = FrameTransform(*names, 0.0, int(static), *told.translation, *told.rotation)
        self._show(child, Entry(transform, parent, told.stamp, until, ours=False))

    def give(self) -> list[FrameTransform]:
        """All frames; those of the hub as of now."""
        now = self._now()
        self._expire(now)
        given = []
        for entry in self._entries.values():
            transform = entry.transform
            if not entry.ours:
                transform.timestamp = now
            given.append(transform)
        return given

    def delete(self, one: str, other: str) -> list[str]:
        """Forget what YARP programs set between two frames, as YARP does it: either way round, or with any frame.

        Returns:
            the children.
        """
        found = [child for child, entry in self._entries.items() if entry.ours and _between(entry, child, one, other)]
        for child in found:
            del self._entries[child]
        return found

    def heard(self, one: str, other: str) -> bool:
        """Whether the transform between two frames is one of the hub."""
        return any(not entry.ours and _between(entry, child, one, other) for child, entry in self._entries.items())

    def own_static(self) -> Iterator[FrameTransform]:
        """The static frames that YARP programs set."""
        return (entry.transform for entry in self._entries.values() if entry.ours and entry.transform.isStatic)

    def forget_timed(self) -> None:
        """Forget all but static frames: time was set back."""
        self._entries = {child: entry for child, entry in self._entries.items() if entry.transform.isStatic}

    def _show(self, child: str, entry: Entry) -> None:
        before = self._entries.get(child)
        if before is not None and before.stamp > entry.stamp and not entry.transform.isStatic:
            return
        if (before is None or before.parent != entry.parent) and self._closes_a_loop(child, entry.parent):
            self._expire(self._now())
            if self._closes_a_loop(child, entry.parent):
                self.left_out["loop"] += 1
                return
        self._entries[child] = entry

    def _closes_a_loop(self, child: str, parent: str) -> bool:
        above: str | None = parent
        while above is not None:
            if above == child:
                return True
            entry = self._entries.get(above)
            above = None if entry is None else entry.parent
        return False

    def _expire(self, now: float) -> None:
        gone = [child for child, entry in self._entries.items() if entry.until < now]
        for child in gone:
            del self._entries[child]


def _between(entry: Entry, child: str, one: str, other: str) -> bool:
    if one == ANY or other == ANY:
        return one in (ANY, entry.parent) and other in (ANY, child)
    return (entry.parent, child) in ((one, other), (other, one))
