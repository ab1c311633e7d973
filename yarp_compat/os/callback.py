"""``TypedReaderCallback``: what a buffered port calls with each message, on a thread of the port."""

from __future__ import annotations

import inspect
import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

log = logging.getLogger("yarp.os.BufferedPort")


class TypedReaderCallback:
    """Derive from it, or from ``BottleCallback`` and its kin, and give it to ``port.useCallback(callback)``."""

    def onRead(self, datum: Any, reader: Any = None) -> None:
        """Take one message; ``reader`` is the port. It may be defined with the first argument only."""
        del datum, reader


class CallbackThread:
    """Calls a callback with what comes, until stopped.

    Args:
        name: for the thread's name.
        take: waits for the next content; given a function that tells when to stop, it returns None then or at the end.
        callback: an object with ``onRead``, or a function.
        port: handed to callbacks that want it.
        lock: held by each call.
    """

    def __init__(
        self,
        name: str,
        take: Callable[[Callable[[], bool]], Any],
        callback: Any,
        port: Any,
        lock: AbstractContextManager[Any],
    ) -> None:
        self._take = take
        self._lock = lock
        self._call = _caller(getattr(callback, "onRead", callback), port)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"yarp callback {name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while (content := self._take(self._stopped.is_set)) is not None:
            try:
                with self._lock:
                    self._call(content)
            except Exception:
                log.exception("a callback failed; the port goes on with the next message")

    def stop(self, wake: Callable[[], None]) -> None:
        """Call it no more, and wait for a call that runs unless that is this one.

        Args:
            wake: has the taker look whether it should stop.
        """
        self._stopped.set()
        wake()
        if threading.current_thread() is not self._thread:
            self._thread.join()


def _caller(function: Callable[..., Any], port: Any) -> Callable[[Any], Any]:
    """The callback as a function of the content alone."""
    try:
        inspect.signature(function).bind(None, None)
    except TypeError:
        return function
    return lambda content: function(content, port)
