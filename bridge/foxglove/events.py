"""What clients do, from the SDK's threads to the worker's: as state that grows with what clients have open, no further.

The SDK calls on the threads that also send (its ``ServerListener``), so that nothing here waits.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock

from foxglove.websocket import ChannelView, Client, ServerListener


class Events(ServerListener):
    """The SDK's listener.

    Args:
        changed: called on the SDK's threads after a change, once until `take` was called.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._lock = Lock()
        self._told = False
        self._watched: dict[int, set[int]] = {}
        self._late: set[int] = set()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """A client wants a channel."""
        with self._lock:
            self._watched.setdefault(channel.id, set()).add(client.id)
            self._late.add(channel.id)
            self._wake()

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """A client no longer wants a channel, or is gone, or the channel is."""
        with self._lock:
            clients = self._watched.get(channel.id, set())
            clients.discard(client.id)
            if not clients:
                self._watched.pop(channel.id, None)
                self._late.discard(channel.id)
            self._wake()

    def take(self) -> tuple[set[int], set[int]]:
        """The channels that are watched, and those of them that somebody began to watch since the last call."""
        with self._lock:
            self._told = False
            late, self._late = self._late, set()
            return set(self._watched), late

    def _wake(self) -> None:
        if not self._told:
            self._told = True
            self._changed()
