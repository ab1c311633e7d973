"""A cache of latched messages for late joiners."""

from __future__ import annotations

from collections import deque


class LatchedCache:
    """The last ``depth`` messages of each source, at least one."""

    def __init__(self, depth: int) -> None:
        self._depth = max(depth, 1)
        self._sources: dict[str, deque[bytes]] = {}

    def add(self, payload: bytes, source: str) -> None:
        """Append a source's newest message."""
        messages = self._sources.pop(source, None) or deque(maxlen=self._depth)
        messages.append(payload)
        self._sources[source] = messages  # the source that published last moves to the end

    def drop_source(self, source: str) -> None:
        """Drop a source's messages."""
        self._sources.pop(source, None)

    def all(self) -> list[bytes]:
        """Return the messages of all sources, ending with the source that published last."""
        return [payload for messages in self._sources.values() for payload in messages]
