"""The frames of a buffer: names, numbers and sources."""

from __future__ import annotations

from collections.abc import Iterator

from bridge.tf.history import TransformHistory
from bridge.tf.layout import NONE, STATIC
from bridge.tf.transform import FrameInfo, TransformSource

MAX_FRAMES = 10_000
"""Maximum number of frames, so that a publisher that generates names cannot exhaust the memory."""

MAX_SOURCES = 16
"""Maximum number of sources that are stored for a frame."""


class Frame:
    """A frame, its number in the history's arrays, and the sources of its transforms."""

    __slots__ = ("_earlier", "authority", "kind", "name", "number", "parent", "stamp")

    def __init__(self, name: str, number: int) -> None:
        self.name = name
        self.number = number
        self.kind = NONE
        self.authority = ""
        self.parent = 0
        self.stamp = 0
        self._earlier: dict[tuple[int, str], int] = {}

    def switch(self, parent: int, authority: str) -> None:
        """Store the source of the newest transform; it must differ from the previous source."""
        if self.parent:
            self._earlier.pop((self.parent, self.authority), None)
            self._earlier[self.parent, self.authority] = self.stamp
            if len(self._earlier) >= MAX_SOURCES:
                del self._earlier[next(iter(self._earlier))]
        self.parent, self.authority = parent, authority

    def sources(self, since: int) -> dict[tuple[int, str], int]:
        """Return the current source (parent, authority) and those since a stamp in ns, each with its last stamp."""
        stamps = {(self.parent, self.authority): self.stamp}
        for source, stamp in reversed(self._earlier.items()):
            if stamp >= since:
                stamps.setdefault(source, stamp)
        return stamps

    def forget_sources(self) -> None:
        """Remove the frame's sources."""
        self.parent, self.authority, self.stamp = 0, "", 0
        self._earlier.clear()


class FrameTable:
    """All frames, numbered from 1 in the order in which their names first appear in a transform."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}
        self.known: dict[str, Frame] = {}  # frames that have transforms, or had some before a `clear`
        self._frames: list[Frame] = [Frame("", 0)]

    @property
    def full(self) -> bool:
        """Whether two more frames, a parent and a child, would exceed the limit."""
        return len(self._frames) > MAX_FRAMES - 2

    def get(self, name: str) -> Frame:
        """Return the frame of this name; create it if it is new."""
        number = self.numbers.get(name)
        if number is not None:
            return self._frames[number]
        number = self.numbers[name] = len(self._frames)
        frame = Frame(name, number)
        self._frames.append(frame)
        return frame

    def __getitem__(self, number: int) -> Frame:
        return self._frames[number]

    def __iter__(self) -> Iterator[Frame]:
        return iter(self._frames[1:])

    def infos(self, history: TransformHistory) -> list[FrameInfo]:
        """Return information on each frame that has a parent, sorted by name."""
        return sorted((self._info(f, history) for f in self if f.kind != NONE and f.parent), key=lambda info: info.name)

    def _info(self, frame: Frame, history: TransformHistory) -> FrameInfo:
        parent, _ = history.newest(frame.number)
        static = frame.kind == STATIC
        oldest, newest, samples = history.ends(frame.number)
        since = 0 if static else newest - history.span
        sources = tuple(
            TransformSource(self._frames[above].name, authority, stamp)
            for (above, authority), stamp in frame.sources(since).items()
        )
        times = (0, 0) if static else (oldest, newest)
        return FrameInfo(frame.name, self._frames[parent].name, frame.authority, static, *times, samples, sources)
