"""A lock that a thread may release and acquire again in a loop, so that others do not wait for the end of the loop."""

from __future__ import annotations

from threading import Lock
from types import TracebackType


class FairLock:
    """A lock that a thread which already waits for it acquires before one that has just released it.

    After Python's own lock is released, the same thread usually acquires it again before a waiting one has woken up.
    """

    __slots__ = ("_lock", "_next")

    def __init__(self) -> None:
        self._lock = Lock()
        self._next = Lock()  # of the thread that acquires `_lock` next

    def locked(self) -> bool:
        """Return whether a thread has the lock."""
        return self._lock.locked()

    def __enter__(self) -> None:
        with self._next:
            self._lock.acquire()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()
