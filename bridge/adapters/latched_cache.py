"""The cache from which late joiners get the messages of a latched topic."""

from __future__ import annotations

from collections import deque


class LatchedCache:
    """The last messages of each source."""

    def __init__(self, depth: int) -> None:
        self._depth = max(depth, 1)
        self._sources: dict[str, deque[bytes]] = {}

    def add(self, payload: bytes, source: str) -> None:
        """A source's newest message."""
        messages = self._sources.pop(source, None) or deque(maxlen=self._depth)
        messages.append(payload)
        self._sources[source] = messages  # the source that spoke last comes last

    def forget(self, source: str) -> None:
        """Drop what a source said."""
        self._sources.pop(source, None)

    def all(self) -> list[bytes]:
        """Every source's messages, those of the source that spoke last at the end."""
        return [payload for messages in self._sources.values() for payload in messages]
