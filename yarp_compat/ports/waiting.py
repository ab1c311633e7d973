"""Messages that wait for their turn on a connection."""

from __future__ import annotations

from collections import Counter, deque

from yarp_compat.wire import message
from yarp_compat.wire.message import Buffer

ITEM_BYTES = 192
"""What a message costs in the queue besides its own bytes (measured: 174 in CPython 3.11)."""


class Item:
    """A message on its way out."""

    __slots__ = ("buffers", "done", "dropped", "ours")

    def __init__(self, buffers: list[Buffer], ours: bool) -> None:
        self.buffers = buffers
        self.done = False
        self.dropped = False
        """It made room for another one."""
        self.ours = ours
        """The thread that wrote it also sees it through."""

    def own(self) -> None:
        """Have its bytes to itself: their owner may change them from now on."""
        if self.buffers:
            self.buffers = [b"".join(self.buffers)]


class Waiting:
    """A queue of bounded bytes; one message fits always.

    Args:
        limit: bytes, with what each message costs besides its own.
        dropped: counts those that made room, by reason.
    """

    def __init__(self, limit: int, dropped: Counter[str]) -> None:
        self._limit = limit
        self._dropped = dropped
        self._items: deque[Item] = deque()
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._items)

    def put(self, item: Item, strict: bool) -> None:
        """Let a message wait: behind the others, the oldest of which make room; or not ``strict``, in their place."""
        if not strict:
            while (replaced := self.next()) is not None:
                self._drop(replaced, "replaced")
        size = _cost(item)
        while self._bytes + size > self._limit and (oldest := self.next()) is not None:
            self._drop(oldest, "full")
        self._items.append(item)
        self._bytes += size

    def _drop(self, item: Item, reason: str) -> None:
        item.dropped = True
        self._dropped[reason] += 1

    def next(self) -> Item | None:
        """The message whose turn it is."""
        if not self._items:
            return None
        item = self._items.popleft()
        self._bytes -= _cost(item)
        return item

    def clear(self) -> int:
        """Let none wait; how many there were."""
        count = len(self._items)
        self._items.clear()
        self._bytes = 0
        return count


def _cost(item: Item) -> int:
    return message.size(item.buffers) + ITEM_BYTES
