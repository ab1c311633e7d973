"""An output connection, which sends as much as the socket accepts at once, and the rest on the shared thread."""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable

from yarp_compat.in_flight import unacknowledged
from yarp_compat.ports.base import MessageCounters
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.outgoing import Item, SendQueue
from yarp_compat.ports.output_socket import OutputSocket
from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reply import ReplyEnd, ReplyWatch

_log = logging.getLogger("yarp.ports")
_POLL = 0.01
"""Seconds between attempts to send on a socket that the system's ``select`` cannot watch."""


class Output:
    """One output connection on a stream of bytes.

    At any time, at most one thread uses the connection. This thread, the driver, is a writing thread, or the shared
    thread while messages are queued. Only the driver accesses ``_current`` and the socket's data.

    Attributes:
        socket_side: the part that reads from and writes to the socket.
        waiters: number of threads that wait until the connection is free, or for their message.
    """

    group = None  # only datagrams are sent to a group

    def __init__(
        self,
        sock: socket.socket,  # connected and introduced
        route: ConnectionRoute,  # the connection's names
        carrier: Carrier,  # the carrier of the connection
        loop: PortLoop,  # the shared thread
        lost: Callable[[Output], object],  # called when the connection is lost
        limit: int,  # maximum bytes of a reply
        room: int,  # maximum bytes of the queue
        dropped: Counter[str] | None = None,  # counts the port's drops, by reason
    ) -> None:
        self.route = route
        self.carrier = carrier
        self.profile: Profile | None = None
        self.counters = MessageCounters(whole=dropped)
        self.closed = False
        self._loop = loop
        self._lost = lost
        self._limit = limit
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self.waiters = 0
        self._pending = SendQueue(room, self.counters.drop)
        self._driven = False
        self._current: Item | None = None
        self.socket_side = OutputSocket(sock, route, carrier, limit)

    @property
    def sock(self) -> socket.socket:
        """The socket, only for its options."""
        return self.socket_side.sock

    @property
    def sent_bytes(self) -> int:
        """The number of bytes of messages that the system has accepted."""
        return self.socket_side.sent_bytes

    @property
    def acknowledged(self) -> int:
        """The number of these bytes that the peer's system has acknowledged; all of them, if the socket is closed."""
        try:
            return self.sent_bytes - unacknowledged(self.sock)
        except (OSError, ValueError):
            return self.sent_bytes

    def begin(self, buffers: list[Buffer], strict: bool, wait: bool) -> Item | None:
        """Send as much of a message as the socket accepts, the rest later; None if the connection is closed or lost.

        ``strict``: do not replace queued messages; ``wait``: the caller keeps the bytes unchanged, and calls `finish`.
        """
        item = Item(buffers, wait)
        with self._lock:
            if self.closed:
                return None
            if self._driven:
                self._queue(item, strict)
                return item
            self._driven = True
        try:
            if not self.socket_side.due or self.socket_side.read_ack():
                self._current = item
                if self._send(item) and not (wait and self.socket_side.due):
                    self._settle(item)
                    return item
            elif wait:
                self._current = item
            else:
                with self._lock:
                    self._queue(item, strict)
        except OSError:
            self._on_lost()
            return None
        if not wait:
            self._drive_later()
        return item

    def finish(self, item: Item, deadline: float | None = None) -> bool:
        """Wait until a message is sent (and acknowledged); return False if it is late, replaced or lost."""
        if item is not self._current or not item.writer_completes:
            with self._lock:
                self._wait_for(lambda: item.done or item.dropped or self.closed, deadline)
            return item.done
        try:
            while not self._advance(item):
                if self.closed:
                    self._dispose()
                    return False
                if deadline is not None and time.monotonic() > deadline:
                    self.detach(item)
                    return False
        except OSError:
            self._on_lost()
            return False
        except BaseException:  # such as KeyboardInterrupt
            self.detach(item)
            raise
        self._settle(item)
        return True

    def detach(self, item: Item) -> None:
        """Let the shared thread complete a message that its writer does not `finish`."""
        if item is self._current and item.writer_completes:
            item.writer_completes = False
            self._drive_later()

    def _advance(self, item: Item) -> bool:
        """Try for up to one step to complete a message; return whether it is sent and acknowledged."""
        return (not item.buffers or self._push(item)) and self._acknowledged()

    def _push(self, item: Item) -> bool:
        """Try for up to one step to send a message; return whether it is sent."""
        return self._acknowledged() and self._send(item, patient=True)

    def _acknowledged(self) -> bool:
        """Wait up to one step for the outstanding acknowledgment; return whether none is left."""
        return not self.socket_side.due or self.socket_side.read_ack(patient=True)

    def _send(self, item: Item, *, patient: bool = False) -> bool:
        """Send as much of a message as the socket accepts; return whether it is all sent."""
        done = self.socket_side.send(item, patient=patient)
        self.counters.sent += done
        return done

    def _wait_for(self, condition: Callable[[], bool], deadline: float | None) -> bool:
        """Wait for a condition, with the lock held; return whether it became true."""
        self.waiters += 1
        try:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            return self._changed.wait_for(condition, left)
        finally:
            self.waiters -= 1

    def _settle(self, item: Item) -> None:
        """Complete a message; then continue with queued ones, or free the connection."""
        item.done = True
        self._current = None
        with self._lock:
            if not self._pending and not self.closed:
                self._driven = False
                if self.waiters:
                    self._changed.notify_all()
                return
        if self.closed:
            self._dispose()
        else:
            self._loop.call_soon(self._drive)

    def _queue(self, item: Item, strict: bool) -> None:
        """Queue a message; the caller holds the lock."""
        item.copy_bytes()
        item.writer_completes = False
        self._pending.put(item, strict)
        if self.waiters:
            self._changed.notify_all()  # a thread may wait for a message that was dropped

    def _drive_later(self) -> None:
        """Let the shared thread continue."""
        if self._current is not None:
            self._current.copy_bytes()
        self._loop.call_soon(self._drive)

    def _drive(self) -> None:
        """Send queued messages, on the shared thread."""
        try:
            events = self._step()
        except OSError:
            self._loop.unwatch(self.socket_side.sock)
            self._on_lost()
            return
        if events is None:
            return
        if events and not self.closed:
            self._drive_when(events)
            return
        self._loop.unwatch(self.socket_side.sock)
        self._dispose()

    def _drive_when(self, events: int) -> None:
        """Continue on the shared thread when the socket is readable, or else writable."""
        reads = events == selectors.EVENT_READ
        try:
            self._loop.watch(self.socket_side.sock, self._drive if reads else None, None if reads else self._drive)
        except OSError:
            self._loop.call_later(_POLL, self._drive)

    def _step(self) -> int | None:
        """Return the events to wait for; 0 if the connection is closed; None if another thread may drive."""
        while not self.closed:
            item = self._current
            if self.socket_side.due and not self.socket_side.read_ack():
                return selectors.EVENT_READ
            if item is not None and item.buffers and not self._send(item):
                return selectors.EVENT_WRITE
            if self.socket_side.due:
                continue
            with self._lock:
                if item is not None:
                    item.done = True
                self._current = self._pending.next()
                free = self._current is None and not self.closed
                if free:
                    self._loop.unwatch(self.socket_side.sock)
                    self._driven = False
                self._changed.notify_all()
                if free:
                    return None
        return 0

    @property
    def busy(self) -> bool:
        """Whether a message is being sent or not yet acknowledged."""
        if self.socket_side.due and not self._driven:
            self.check()  # the acknowledgment may have arrived: no thread reads between two messages
        return self._driven or self.socket_side.due

    def wait_idle(self, deadline: float | None) -> bool:
        """Wait until all messages are sent and acknowledged; return False after the deadline or a lost connection."""
        with self._lock:
            if not self._wait_for(lambda: not self._driven or self.closed, deadline):
                return False
            if self.closed or not self.socket_side.due:
                return True
            self._driven = True
        self._current = Item([], writer_completes=True)
        return self.finish(self._current, deadline)

    def request(self, buffers: list[Buffer], parse: ReplyEnd | None, deadline: float | None) -> bytes:
        """Send a request and wait for the reply until the deadline of the monotonic clock.

        ``parse`` finds the end of the reply; None: the end of a Bottle, or of a line for text carriers. Raises
        `TimeoutError` (and closes the connection, because the reply may still arrive), `ConnectionError` if the
        connection is lost, `WireError` if the reply is invalid or above the limit (and closes the connection), or if
        only an acknowledgment arrives.
        """
        with self._lock:
            if self._driven:
                self._wait_for(lambda: not self._driven or self.closed, deadline)
            if self.closed:
                raise ConnectionResetError(self.socket_side.closed_message())
            if self._driven:
                raise TimeoutError(f"{self.route.target} is still busy with another message")
            self._driven = True
        item = self._current = Item(buffers, writer_completes=True)
        try:
            while not self._push(item):
                self._check_time(deadline)
            watch = ReplyWatch(parse, self.carrier, self.profile, self._limit)
            reply = self.socket_side.reply(watch, lambda: self._check_time(deadline))
            if reply is not None:
                self.profile = watch.profile
            while not self._acknowledged():
                self._check_time(deadline)
        except BaseException:
            self._on_lost()
            raise
        self._settle(item)
        if reply is None:
            raise WireError(f"{self.route.target} acknowledged a request without replying")
        self.counters.received += 1
        return reply

    def _check_time(self, deadline: float | None) -> None:
        if self.closed:
            raise ConnectionAbortedError(self.socket_side.closed_message())
        if deadline is not None and time.monotonic() > deadline:
            raise TimeoutError(f"no reply from {self.route.target} in time")

    def check(self) -> None:
        """Check an idle connection and read its acknowledgment.

        This method holds the lock instead of becoming the driver, so that writers still see the connection as free.
        """
        with self._lock:
            if self._driven or self.closed:
                return
            with contextlib.suppress(OSError):  # an error means that the connection is lost
                if self.socket_side.is_connected():
                    return
            self._driven = True
        self._on_lost()

    def close(self) -> None:
        """Close the connection; send a farewell first if it is idle."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
            free = not self._driven
            self._driven = True
            self._changed.notify_all()
        if free:
            with contextlib.suppress(OSError):
                self.socket_side.send_farewell(patient=not self._loop.is_own_thread)
            self._dispose()
            return
        with contextlib.suppress(OSError):
            self.socket_side.shutdown()  # wakes up the driver, which closes the socket

    def abandon(self) -> None:
        """Close the socket in a forked child process, without a farewell."""
        self._lock = threading.Lock()  # another thread may have held it in the parent process
        self._changed = threading.Condition(self._lock)
        self.closed = True
        self._dispose()

    def _dispose(self) -> None:
        """Close the socket; only the driver may call this."""
        with self._lock:
            self.counters.drop("lost", self._pending.clear())
            self._changed.notify_all()
        self.socket_side.close()
        if lost := self.counters.dropped["lost"]:
            _log.info("%s -> %s closed with %d unsent messages", self.route.source, self.route.target, lost)

    def _on_lost(self) -> None:
        with self._lock:
            closed = self.closed
            if self._current is not None and not self._current.done:
                self.counters.drop("lost")
        try:
            if not closed:
                self._lost(self)  # before `closed` is set, so that no listed connection is closed
        finally:
            with self._lock:
                self.closed = True
            self._dispose()
