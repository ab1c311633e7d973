"""What tells others of an endpoint of ours."""

from __future__ import annotations

import threading
from collections.abc import Callable

Withdraw = Callable[[], None]


class Announcement:
    """Tells of an endpoint, and takes that back when the endpoint closes.

    It is told once the endpoint is there: whoever hears of it calls, publishes or asks at once. An endpoint that has
    been closed by then is not told at all.

    Args:
        tell: tells of the endpoint; returns what takes it back.
    """

    def __init__(self, tell: Callable[[], Withdraw]) -> None:
        self._tell = tell
        self._lock = threading.Lock()
        self._withdraw: Withdraw | None = None
        self._over = False

    def tell(self) -> None:
        """The endpoint is there."""
        with self._lock:
            if not self._over:
                self._withdraw = self._tell()

    def withdraw(self) -> None:
        """The endpoint closes. Safe to call twice."""
        with self._lock:
            self._over = True
            withdraw, self._withdraw = self._withdraw, None
        if withdraw is not None:
            withdraw()
