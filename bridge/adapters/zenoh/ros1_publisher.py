"""A publisher in the ros1 dialect.

The dialect has no latching: its subscribers are zenoh's plain ones, and nobody asks for what was said before. What a
latched publisher keeps is put again when somebody subscribes who did not hear it, as far as the wire tells: when the
key gets its first subscriber, and when another bridge begins to tell that it subscribes. Whoever heard it before
hears it again then. A plain ``get`` on the key is answered with it too.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import zenoh

from bridge.adapters.zenoh.kept_publisher import KeptPublisher
from bridge.hub.qos import Qos

AGAIN = 3.0
"""Seconds between two times that what is kept is put again for further bridges."""

_SETTLE = 0.5
"""Seconds that a bridge which tells that it subscribes is given to do so."""


class Ros1KeyPublisher(KeptPublisher):
    """A topic of ours in the ros1 dialect."""

    def __init__(
        self,
        session: zenoh.Session,
        topic: str,
        key: str,
        qos: Qos,
        withdraw: Callable[[], None],
        closed: Callable[[KeptPublisher], None],
    ) -> None:
        super().__init__(session, key, qos, None, closed)
        self.topic = topic
        self._withdraw = withdraw
        self._due: float | None = None
        self._last = -AGAIN
        if qos.latched:
            self.watch(self._matched)

    def _matched(self) -> None:
        self._due = time.monotonic()

    def newcomer(self, *, first: bool) -> None:
        """A bridge begins to tell that it subscribes, the first one of the topic or another."""
        now = time.monotonic()
        if not self._qos.latched or self._due is not None or (first and now - self._last < AGAIN):
            return  # the first one has had it as the key's first subscriber
        self._due = max(now + _SETTLE, self._last + AGAIN)

    def tick(self, now: float) -> None:
        """Put what is kept again where it is time."""
        due = self._due
        if due is not None and now >= due:
            self._due, self._last = None, now
            self.put_again()

    def close(self) -> None:
        """Give the key back. Safe to call twice."""
        if self._sink is not None:
            self._withdraw()
        super().close()
