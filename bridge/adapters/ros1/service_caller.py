"""Calling a ROS 1 server: persistent connections, of which each call has one to itself.

A connection is kept open while nothing is called, so that the death of a server is known before the next call.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable

from bridge.adapters.ros1.errors import ExhaustedError, Ros1Error, UnreachableError, unanswered
from bridge.adapters.ros1.graph import Link
from bridge.adapters.ros1.handshake import connect_service
from bridge.adapters.ros1.intake import Intake
from bridge.adapters.ros1.lanes import Lanes
from bridge.adapters.ros1.service_connection import LENGTH, Connection
from bridge.hub.call import Abandon, CallError, Done
from bridge.messages.conversion import SideType

_log = logging.getLogger(__name__)

MAX_CALLS = 1000
"""Calls of one service that are under way at most; each has a connection."""

_MAX_ERROR = 64 * 1024
_KEPT = 8
_CONNECT_SECONDS = 10.0
_FIRST_WAIT = 0.2
_LONGEST_WAIT = 5.0

Doubt = Callable[[Link, str], None]
"""``doubt(link, trouble)``: a server did not answer, or is not what it was."""


class _Pending:
    """One call that is under way; it ends once, whoever is first to end it."""

    def __init__(self, request: bytes, done: Done, over: Callable[[_Pending], None]) -> None:
        self.request = request
        self.line: _Line | None = None
        self._done: Done | None = done
        self._over = over
        self._lock = threading.Lock()

    @property
    def waits(self) -> bool:
        """Whether its end is still wanted."""
        return self._done is not None

    def finish(self, result: bytes | CallError) -> None:
        """Tell the end, unless it has ended before."""
        done = self._take()
        if done is not None:
            done(result)

    def abandon(self) -> None:
        """The caller is gone: a ROS 1 server learns that by its connection alone."""
        if self._take() is not None and self.line is not None:
            self.line.cut()

    def _take(self) -> Done | None:
        with self._lock:
            done, self._done = self._done, None
        if done is not None:
            self._over(self)
        return done


class _Line(Connection):
    """One connection to a server, ready for one call at a time."""

    head = 5

    def __init__(self, sock: socket.socket, link: Link, owner: Caller, intake: Intake, limit: int) -> None:
        super().__init__(sock, intake, limit)
        self.link = link
        self._owner = owner
        self._pending: _Pending | None = None

    def begin(self, pending: _Pending) -> bool:
        """Send a call's request; False where nothing of it was sent, since the connection is over."""
        with self._lock:
            if self._over:
                return False
            self._pending, pending.line = pending, self
        request = pending.request
        if self.send(LENGTH.pack(len(request)), request):
            return True
        with self._lock:
            unsent, self._pending = self._pending is pending, None
        self.cut()
        return not unsent

    def _message(self, head: bytes, body: bytes) -> None:
        pending, self._pending = self._pending, None
        if pending is None:
            self.end("sent something without being asked")
            return
        pending.finish(body if head[0] else CallError(_reason(body)))
        # It may have answered before it had the whole request, or send or close right behind the answer.
        if self.is_at_rest():
            self._owner.freed(self, served=True)
        else:
            self.cut()

    def _too_large(self, size: int) -> bool:
        pending, self._pending = self._pending, None
        trouble = f"announced a reply of {size} bytes, limits.message allows {self._limit}"
        if pending is not None:
            pending.finish(CallError(f"the server {self.link.node} {trouble}"))
        self.end(trouble)
        return False

    def _ended(self, trouble: str) -> None:
        with self._lock:
            pending, self._pending = self._pending, None
        if pending is not None:
            pending.finish(CallError(f"the server {self.link.node} {trouble} before it answered"))
        self._owner.lost(self, trouble)


def _reason(body: bytes) -> str:
    return body[:_MAX_ERROR].decode(errors="replace") or "the server says that it failed, and gives no reason"


class Caller:
    """Calls the server of one name that has one type; see `bridge.adapters.base.EdgeCaller`."""

    def __init__(
        self,
        name: str,
        side_type: SideType,
        *,
        intake: Intake,
        lanes: Lanes,
        node: Callable[[], str],
        doubt: Doubt,
        limit: int,
    ) -> None:
        self.name, self.md5 = name, side_type.type_id
        self._intake, self._lanes, self._node, self._doubt, self._limit = intake, lanes, node, doubt, limit
        self._lock = threading.Lock()
        self._link: Link | None = None
        self._lines: set[_Line] = set()
        self._free: list[_Line] = []
        self._calls: set[_Pending] = set()
        self._warming = False
        self._due, self._wait = 0.0, _FIRST_WAIT
        self._closed = False

    @property
    def restless(self) -> bool:
        """Whether a connection is to be made."""
        return self._link is not None and not self._lines and not self._warming

    def follow(self, link: Link | None) -> None:
        """Take up where the server is now, None where there is none."""
        with self._lock:
            if self._closed:
                return
            moved = link != self._link
            if moved:
                self._link, self._due, self._wait = link, 0.0, _FIRST_WAIT
            old, self._free = (self._free, []) if moved else ([], self._free)
        for line in old:
            line.cut()
        self._warm()

    def call(self, request: bytes, done: Done) -> Abandon:
        """See `bridge.adapters.base.EdgeCaller.call`."""
        pending = _Pending(request, done, self._over)
        with self._lock:
            trouble = self._why_not()
            if not trouble:
                self._calls.add(pending)
        if trouble:
            pending.finish(CallError(trouble))
        else:
            self._begin(pending)
        return pending.abandon

    def close(self) -> None:
        """See `bridge.adapters.base.EdgeCaller.close`."""
        with self._lock:
            self._closed, self._link = True, None
            calls, lines = list(self._calls), list(self._lines)
        for pending in calls:
            pending.finish(CallError(f"{self.name} does not cross any more"))
        for line in lines:
            line.cut()

    def freed(self, line: _Line, *, served: bool) -> None:
        """A line is ready for a call; ``served``: it has carried one."""
        with self._lock:
            keep = not self._closed and line.link == self._link and len(self._free) < _KEPT
            if keep:
                self._free.append(line)
            if served:
                self._due, self._wait = 0.0, _FIRST_WAIT
        if not keep:
            line.cut()

    def lost(self, line: _Line, trouble: str) -> None:
        """A line is over."""
        _log.debug("%s: connection to %s: it %s", self.name, line.link.node, trouble)
        with self._lock:
            self._lines.discard(line)
            if line in self._free:
                self._free.remove(line)
        self._warm()

    def _why_not(self) -> str:
        """Why a call cannot begin now, "" where it can. With the lock held."""
        if self._closed:
            return f"{self.name} does not cross any more"
        if self._link is None:
            return f"{self.name} has no server on ROS 1 now"
        if len(self._calls) >= MAX_CALLS:
            return f"{self.name} is busy: {MAX_CALLS} calls are under way"
        return ""

    def _over(self, pending: _Pending) -> None:
        with self._lock:
            self._calls.discard(pending)

    def _begin(self, pending: _Pending) -> None:
        while (line := self._take()) is not None:
            if line.begin(pending):
                return
        threading.Thread(target=self._begin_anew, args=(pending,), name="midspan-ros1-call", daemon=True).start()

    def _take(self) -> _Line | None:
        with self._lock:
            return self._free.pop() if self._free else None

    def _begin_anew(self, pending: _Pending) -> None:
        link = self._link
        if link is None:
            pending.finish(CallError(f"{self.name} has no server on ROS 1 any more"))
            return
        try:
            line = self._connect(link)
        except Ros1Error as err:
            pending.finish(CallError(f"the server {link.node} of {self.name} cannot be called: {err}"))
            self._suspect(link, err)
            return
        if not pending.waits:
            line.start()
            self.freed(line, served=False)
        elif line.begin(pending):
            line.start()
        else:
            line.end("closed the connection")
            pending.finish(CallError(f"the server {link.node} of {self.name} closed the connection at once"))

    def _connect(self, link: Link) -> _Line:
        """A new line; raises `Ros1Error`. Blocks for a while."""
        fields = {"md5sum": self.md5, "persistent": "1"}
        sock, _ = connect_service(self._node(), link.uri, link.topic, _CONNECT_SECONDS, **fields)
        try:
            line = _Line(sock, link, self, self._intake, self._limit)
        except OSError as err:
            sock.close()
            raise unanswered(f"{link.topic} broke off", err) from None
        with self._lock:
            self._lines.add(line)
        return line

    def _suspect(self, link: Link, err: Ros1Error) -> None:
        if isinstance(err, ExhaustedError):
            return
        if isinstance(err, UnreachableError):
            self._lanes.failed(link.uri)
        self._doubt(link, str(err))

    # -- the connection that is kept open ------------------------------------------------------------------------------

    def _warm(self) -> None:
        """Have a connection, so that the next call is quick and a death is noticed; soon, where it did not last."""
        now = time.monotonic()
        with self._lock:
            link = self._link
            if link is None or self._lines or self._warming or self._due > now:
                return
            self._warming = True
            self._due, self._wait = now + self._wait, min(2 * self._wait, _LONGEST_WAIT)
        self._lanes.submit(link.uri, lambda: self._warmed(link))

    def _warmed(self, link: Link) -> None:
        try:
            line = self._connect(link)
        except Ros1Error as err:
            self._suspect(link, err)
            return
        finally:
            self._warming = False
        self._lanes.answered(link.uri)
        line.start()
        self.freed(line, served=False)
