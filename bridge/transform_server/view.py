"""The frames that YARP programs see, and the clock of these programs."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace

from bridge.clock import RunClock
from bridge.tf.stamped import Stamped
from yarp_compat.dev.frametransform import FrameTransform

_DAY = 86_400.0


class YarpClock:
    """The time of YARP programs, in seconds, and the conversion of their stamps to the run's time.

    In a simulated run, YARP programs may use the run's clock (a network clock) or the system's; a stamp more than a day
    from the system's time shows that its writer uses the run's clock.

    Args:
        on_run_clock: whether the YARP programs that read frames use the run's clock, and not the system's.
    """

    def __init__(self, run: RunClock, *, on_run_clock: bool) -> None:
        self._run = run
        self._on_run_clock = on_run_clock or not run.simulated

    def now(self) -> float:
        """Return the time of the reading programs, in seconds."""
        return self._run.now_ns() / 1e9 if self._on_run_clock else time.time()

    def age(self, stamp: float) -> float:
        """Return the seconds since a stamp, measured on its writer's clock."""
        system = time.time()
        if self._run.simulated and abs(system - stamp) > _DAY:
            return self._run.now_ns() / 1e9 - stamp
        return system - stamp

    def to_readers(self, stamp: float) -> float:
        """Convert a writer's stamp to the clock of the reading programs."""
        return self.now() - self.age(stamp) if self._run.simulated else stamp

    def to_run_ns(self, stamp: float) -> int:
        """Convert a writer's stamp to ns on the run's clock."""
        return self._run.now_ns() - round(self.age(stamp) * 1e9) if self._run.simulated else round(stamp * 1e9)


ANY = "*"
"""The name that matches every frame in a deletion."""

_MARGIN = 1.25
"""Factor for the lifetime of the hub's frames, because a frame that is sent exactly once per lifetime may be late."""


class ShownFrame:
    """A frame in the view.

    Attributes:
        transform: the transform as it is sent to YARP programs.
        parent: the parent's name, without the leading slash that some YARP programs use.
        stamp: ns on the run's clock.
        until: the time of the YARP programs at which the frame expires, in seconds.
        ours: whether a YARP program set it; otherwise it comes from a publisher on the hub.
    """

    __slots__ = ("ours", "parent", "stamp", "transform", "until")

    def __init__(self, transform: FrameTransform, parent: str, stamp: int, until: float, *, ours: bool) -> None:
        self.transform, self.parent, self.stamp, self.until, self.ours = transform, parent, stamp, until, ours


class View:
    """The frames that YARP's own transform server would have. Not thread-safe: the caller must hold a lock.

    YARP's clients drop transforms whose stamps are older than 0.2 s, and hang if frames form a loop. Therefore frames
    from the hub get the current time whenever they are sent, and a frame that would close a loop is omitted.

    Args:
        now: returns the time of the YARP programs, in seconds.
        yarp_lifetime: seconds after its stamp for which a frame from a YARP program is shown.
        ros_lifetime: seconds after its arrival for which a frame from the hub is shown, apart from a margin.
    """

    def __init__(self, now: Callable[[], float], yarp_lifetime: float, ros_lifetime: float) -> None:
        self._now = now
        self.yarp_lifetime, self.ros_lifetime = yarp_lifetime, ros_lifetime
        self._entries: dict[str, ShownFrame] = {}
        self._spelled: dict[str, str] = {}
        self.left_out: Counter[str] = Counter()  # transforms that are not shown, by reason

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def ours(self) -> int:
        """Number of frames that YARP programs set."""
        entries = list(self._entries.values())  # in one step, because the module's health is read without the lock
        return sum(entry.ours for entry in entries)

    def is_static(self, child: str) -> bool:
        """Return whether a YARP program set this frame, as static."""
        entry = self._entries.get(child)
        return entry is not None and entry.ours and bool(entry.transform.isStatic)

    def remember_spelling(self, name: str) -> None:
        """Store a frame's name as the first program that sets it spells it, because programs look only for that."""
        plain = name.lstrip("/")
        if plain in self._spelled:
            return
        self._spelled[plain] = name
        if plain != name:
            for child, entry in self._entries.items():
                if plain in (child, entry.parent):
                    parent, child = self._spelled.get(entry.parent, entry.parent), self._spelled.get(child, child)
                    entry.transform = replace(entry.transform, src_frame_id=parent, dst_frame_id=child)

    def set(self, transform: FrameTransform, published: Stamped) -> None:
        """Show a frame that a YARP program set: ``transform`` as set, ``published`` as it was published on the hub."""
        until = math.inf if transform.isStatic else transform.timestamp + self.yarp_lifetime
        self._show(
            published.child_frame_id, ShownFrame(transform, published.frame_id, published.stamp, until, ours=True)
        )

    def set_from_hub(self, published: Stamped, *, static: bool) -> None:
        """Show a frame from the hub; static frames do not expire."""
        parent, child = published.frame_id.lstrip("/"), published.child_frame_id.lstrip("/")
        until = math.inf if static else self._now() + _MARGIN * self.ros_lifetime
        spelled = self._spelled.get
        names = spelled(parent, parent), spelled(child, child)
        transform = FrameTransform(*names, 0.0, int(static), *published.translation, *published.rotation)
        self._show(child, ShownFrame(transform, parent, published.stamp, until, ours=False))

    def frames(self) -> list[FrameTransform]:
        """Return all frames; those from the hub get the current time."""
        now = self._now()
        self._expire(now)
        transforms = []
        for entry in self._entries.values():
            transform = entry.transform
            if not entry.ours:
                transform.timestamp = now
            transforms.append(transform)
        return transforms

    def delete(self, first: str, second: str) -> list[str]:
        """Delete the transforms that YARP programs set between two frames, in either order; return the child frames.

        With `ANY` as one of the names, ``first`` is the parent and ``second`` the child.
        """
        children = [
            child for child, entry in self._entries.items() if entry.ours and _between(entry, child, first, second)
        ]
        for child in children:
            del self._entries[child]
        return children

    def is_from_hub(self, first: str, second: str) -> bool:
        """Return whether the transform between two frames is from the hub."""
        return any(not entry.ours and _between(entry, child, first, second) for child, entry in self._entries.items())

    def own_static(self) -> Iterator[FrameTransform]:
        """Yield the static frames that YARP programs set."""
        return (entry.transform for entry in self._entries.values() if entry.ours and entry.transform.isStatic)

    def forget_timed(self) -> None:
        """Remove all but static frames, because time was set back."""
        self._entries = {child: entry for child, entry in self._entries.items() if entry.transform.isStatic}

    def _show(self, child: str, entry: ShownFrame) -> None:
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
        expired = [child for child, entry in self._entries.items() if entry.until < now]
        for child in expired:
            del self._entries[child]


def _between(entry: ShownFrame, child: str, first: str, second: str) -> bool:
    if first == ANY or second == ANY:
        return first in (ANY, entry.parent) and second in (ANY, child)
    return (entry.parent, child) in ((first, second), (second, first))
