"""What publishers keep of latched topics for those who come late."""

from __future__ import annotations

from collections import deque


class Kept:
    """The last messages of each source."""

    def __init__(self, depth: int) -> None:
        self._depth = max(depth, 1)
        self._sources: dict[str, deque[bytes]] = {}

    def add(self, payload: bytes, source: str) -> None:
        """A source's newest message."""
        kept = self._sources.pop(source, None) or deque(maxlen=self._depth)
        kept.append(payload)
        self._sources[source] = kept  # the source that spoke last comes last

    def forget(self, source: str) -> None:
        """A source is gone."""
        self._sources.pop(source, None)

    def all(self) -> list[bytes]:
        """Every source's messages, those of the source that spoke last at the end."""
        return [payload for kept in self._sources.values() for payload in kept]
