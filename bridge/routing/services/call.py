"""One call on its way through the bridge."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from threading import Lock
from typing import Protocol

from bridge.hub.call import Abandon, CallError, Done
from bridge.messages.errors import MessageError

_log = logging.getLogger(__name__)

Convert = Callable[[bytes], bytes] | None


class Way(Protocol):
    """What a call needs of its route."""

    request: Convert
    reply: Convert

    def ask(self, request: bytes, done: Done) -> Abandon:
        """Call the far server."""

    def carry(self, work: Callable[[], None], size: int) -> bool:
        """Do a piece of work about so many bytes, now or, where they are many, soon; False where there is no room."""

    def refuse(self, error: str, reason: str) -> None:
        """Count bytes that could not be taken."""

    def over(self, call: Passing, result: bytes | CallError | None, nanoseconds: int) -> None:
        """A call ended, or was abandoned with None, after so long."""


class Passing:
    """A call between the caller on the one network and the server on the other. It ends once, whatever comes twice."""

    __slots__ = ("_abandon_far", "_began", "_done", "_lock", "_over", "_way")

    def __init__(self, way: Way, done: Done) -> None:
        self._way, self._done = way, done
        self._began = time.monotonic_ns()
        self._lock = Lock()
        self._over = False
        self._abandon_far: Abandon | None = None

    def begin(self, request: bytes) -> None:
        """Convert the request and ask the far server, on a thread of the edge or of zenoh."""
        if self._over:
            return
        try:
            data = request if self._way.request is None else self._way.request(request)
        except (MessageError, ValueError) as err:
            self._way.refuse(str(err), "bad")
            self.end(CallError(f"the request is not what its type says: {err}"))
            return
        try:
            abandon = self._way.ask(data, self._came)
        except Exception as err:
            _log.exception("a call could not be made")
            self.end(CallError(f"the call could not be made: {type(err).__name__}: {err}"))
            return
        with self._lock:
            self._abandon_far, over = abandon, self._over
        if over:
            abandon()  # the caller left meanwhile; after an end it does nothing

    def _came(self, result: bytes | CallError) -> None:
        if isinstance(result, CallError):
            self.end(result)
        elif not self._way.carry(lambda: self._finish(result), len(result)):
            self.end(CallError("too many large replies are under way; call again later"))

    def _finish(self, reply: bytes) -> None:
        try:
            data = reply if self._way.reply is None else self._way.reply(reply)
        except (MessageError, ValueError) as err:
            self._way.refuse(str(err), "bad")
            self.end(CallError(f"the reply is not what its type says: {err}"))
            return
        self.end(data)

    def end(self, result: bytes | CallError) -> None:
        """Tell the caller; what comes later is passed over."""
        if self._end():
            self._way.over(self, result, time.monotonic_ns() - self._began)
            self._done(result)

    def abandon(self) -> None:
        """The caller is gone: the far server's reply is not wanted any more."""
        if self._end():
            self._way.over(self, None, 0)
            self.leave()

    def leave(self) -> None:
        """Have the far side forget the call."""
        with self._lock:
            abandon = self._abandon_far
        if abandon is not None:
            abandon()

    def _end(self) -> bool:
        with self._lock:
            over, self._over = self._over, True
        return not over
