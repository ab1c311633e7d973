"""Watches a full socket until it is writable again, and pauses while the system has no memory for records."""

from __future__ import annotations

from collections.abc import Callable

FIRST_PAUSE, LAST_PAUSE = 0.001, 0.1
"""Seconds until the next attempt after the system had no memory; each further pause is twice as long, up to the last.

A socket stays writable meanwhile, so its watcher would try again at once, on the thread that also serves all others.
"""


class WriteWatch:
    """The watch of one socket. Not thread-safe: the lock of the reader's link guards it.

    Args:
        watch: called with True to be notified once the socket is writable, and with False when this is over.
        later: calls a function after some seconds.
    """

    def __init__(self, watch: Callable[[bool], None], later: Callable[[float, Callable[[], None]], None]) -> None:
        self._watch, self._later = watch, later
        self._wanted = self._watched = self._pauses = False
        self._seconds = FIRST_PAUSE

    def want(self, wanted: bool) -> None:
        """Watch the socket from now on, at the latest after the pause; or stop watching it."""
        self._wanted = wanted
        self._update()

    def pause(self, resume: Callable[[], None]) -> None:
        """Do not watch the socket for a while; then ``resume`` is called, on another thread, and calls `end_pause`."""
        if not self._pauses:
            self._pauses = True
            self._update()
            self._later(self._seconds, resume)
            self._seconds = min(2 * self._seconds, LAST_PAUSE)

    def end_pause(self) -> None:
        """Watch the socket again if that is wanted."""
        self._pauses = False
        self._update()

    def on_sent(self) -> None:
        """Note that the system had memory: the next pause is short."""
        self._seconds = FIRST_PAUSE

    def _update(self) -> None:
        watched = self._wanted and not self._pauses
        if watched != self._watched:
            self._watched = watched
            self._watch(watched)
