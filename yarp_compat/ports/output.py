"""An output connection: sends at once what the peer takes at once, and the rest on the shared thread."""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable

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


class Output:
    """One output connection on a stream of bytes.

    At any time at most one thread talks on the connection, its driver: a thread that writes, or the shared thread while
    messages wait. The driver alone touches ``_current`` and what is on the wire.

    Attributes:
        speaker: the socket's side.
        waiters: how many threads wait until it is free, or for a message of theirs.
    """

    group = None  # only datagrams are sent to a group

    def __init__(
        self,
        sock: socket.socket,  # connected and introduced
        route: ConnectionRoute,  # the connection's names
        carrier: Carrier,  # how it carries
        loop: PortLoop,  # the shared thread
        lost: Callable[[Output], object],  # called when the peer is gone
        limit: int,  # bytes of a reply
        room: int,  # bytes of the queue
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
        self.speaker = OutputSocket(sock, route, carrier, limit)

    @property
    def sock(self) -> socket.socket:
        """The socket, for its options alone."""
        return self.speaker.sock

    def begin(self, buffers: list[Buffer], strict: bool, wait: bool) -> Item | None:
        """Send a message as far as that goes at once; the rest follows. None where the peer is gone.

        ``strict``: behind others, not in their place; ``wait``: the caller keeps the bytes, and calls :meth:`finish`.
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
            if not self.speaker.due or self.speaker.take_ack():
                self._current = item
                if self._send(item) and not (wait and self.speaker.due):
                    self._settle(item)
                    return item
            elif wait:
                self._current = item
            else:
                with self._lock:
                    self._queue(item, strict)
        except OSError:
            self._fail()
            return None
        if not wait:
            self._hand_over()
        return item

    def finish(self, item: Item, deadline: float | None = None) -> bool:
        """Wait until a message is sent, and acknowledged if it will be; False if late, replaced or the peer left."""
        if item is not self._current or not item.ours:
            with self._lock:
                self._wait_for(lambda: item.done or item.dropped or self.closed, deadline)
            return item.done
        try:
            while not self._advance(item):
                if self.closed:
                    self._dispose()
                    return False
                if deadline is not None and time.monotonic() > deadline:
                    self.leave(item)
                    return False
        except OSError:
            self._fail()
            return False
        except BaseException:  # an interrupt from the keyboard
            self.leave(item)
            raise
        self._settle(item)
        return True

    def leave(self, item: Item) -> None:
        """Let the shared thread see a message through that its writer does not :meth:`finish`."""
        if item is self._current and item.ours:
            item.ours = False
            self._hand_over()

    def _advance(self, item: Item) -> bool:
        """Wait for a step of a message; whether that was its last."""
        return (not item.buffers or self._push(item)) and self._acknowledged()

    def _push(self, item: Item) -> bool:
        """Wait for a step until a message is out; whether it is."""
        return self._acknowledged() and self._send(item, patient=True)

    def _acknowledged(self) -> bool:
        """Wait for a step for the acknowledgement that is due; whether none is any more."""
        return not self.speaker.due or self.speaker.take_ack(patient=True)

    def _send(self, item: Item, *, patient: bool = False) -> bool:
        """Send what the socket takes of a message; whether that was all."""
        done = self.speaker.send(item, patient=patient)
        self.counters.sent += done
        return done

    def _wait_for(self, condition: Callable[[], bool], deadline: float | None) -> bool:
        """Wait for a condition, with the lock held; whether it came true."""
        self.waiters += 1
        try:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            return self._changed.wait_for(condition, left)
        finally:
            self.waiters -= 1

    def _settle(self, item: Item) -> None:
        """A message is done; go on with those that wait, or be free."""
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
            self._loop.call(self._drive)

    def _queue(self, item: Item, strict: bool) -> None:
        """Let a message wait for its turn; with the lock held."""
        item.own()
        item.ours = False
        self._pending.put(item, strict)
        if self.waiters:
            self._changed.notify_all()  # one that somebody waits for may have made room

    def _hand_over(self) -> None:
        """Let the shared thread go on."""
        if self._current is not None:
            self._current.own()
        self._loop.call(self._drive)

    def _drive(self, _: int = 0) -> None:
        """Go on with what waits, on the shared thread."""
        try:
            events = self._step()
        except OSError:
            self._loop.ignore(self.speaker.sock)
            self._fail()
            return
        if events is None:
            return
        if events and not self.closed:
            self._loop.watch(self.speaker.sock, events, self._drive)
            return
        self._loop.ignore(self.speaker.sock)
        self._dispose()

    def _step(self) -> int | None:
        """The events to wait for; 0 where the connection is closed; None where another thread may drive."""
        while not self.closed:
            item = self._current
            if self.speaker.due and not self.speaker.take_ack():
                return selectors.EVENT_READ
            if item is not None and item.buffers and not self._send(item):
                return selectors.EVENT_WRITE
            if self.speaker.due:
                continue
            with self._lock:
                if item is not None:
                    item.done = True
                self._current = self._pending.next()
                free = self._current is None and not self.closed
                if free:
                    self._loop.ignore(self.speaker.sock)
                    self._driven = False
                self._changed.notify_all()
                if free:
                    return None
        return 0

    @property
    def busy(self) -> bool:
        """Whether a message is still on its way out, or not acknowledged."""
        if self.speaker.due and not self._driven:
            self.check()  # the acknowledgement may have come: between two messages nobody reads
        return self._driven or self.speaker.due

    def wait_idle(self, deadline: float | None) -> bool:
        """Wait until nothing is on its way, acknowledgements included; False where something is by the deadline."""
        with self._lock:
            if not self._wait_for(lambda: not self._driven or self.closed, deadline):
                return False
            if self.closed or not self.speaker.due:
                return True
            self._driven = True
        self._current = Item([], ours=True)
        return self.finish(self._current, deadline)

    def request(self, buffers: list[Buffer], parse: ReplyEnd | None, deadline: float | None) -> bytes:
        """Send a message that wants a reply, and wait for it until the deadline of the monotonic clock.

        ``parse`` says where the reply ends; None: at a Bottle's end, or with a text carrier at the line's. Raises
        `TimeoutError` (and closes, as the reply may still come), `ConnectionError` where the connection broke,
        `WireError` where the reply is none or above the limit (and closes), or only an acknowledgement came.
        """
        with self._lock:
            if self._driven:
                self._wait_for(lambda: not self._driven or self.closed, deadline)
            if self.closed:
                raise ConnectionResetError(self.speaker.gone())
            if self._driven:
                raise TimeoutError(f"{self.route.target} is still busy with another message")
            self._driven = True
        item = self._current = Item(buffers, ours=True)
        try:
            while not self._push(item):
                self._check_time(deadline)
            watch = ReplyWatch(parse, self.carrier, self.profile, self._limit)
            reply = self.speaker.reply(watch, lambda: self._check_time(deadline))
            if reply is not None:
                self.profile = watch.profile
            while not self._acknowledged():
                self._check_time(deadline)
        except BaseException:
            self._fail()
            raise
        self._settle(item)
        if reply is None:
            raise WireError(f"{self.route.target} acknowledged a request and did not reply to it")
        self.counters.received += 1
        return reply

    def _check_time(self, deadline: float | None) -> None:
        if self.closed:
            raise ConnectionAbortedError(self.speaker.gone())
        if deadline is not None and time.monotonic() > deadline:
            raise TimeoutError(f"no reply from {self.route.target} in time")

    def check(self) -> None:
        """Look whether the idle peer is there, and has acknowledged: with the lock, so that writers find it free."""
        with self._lock:
            if self._driven or self.closed:
                return
            with contextlib.suppress(OSError):  # it is not in order
                if self.speaker.look():
                    return
            self._driven = True
        self._fail()

    def close(self) -> None:
        """Say goodbye where the connection is free, and close it."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
            free = not self._driven
            self._driven = True
            self._changed.notify_all()
        if free:
            with contextlib.suppress(OSError):
                self.speaker.say_goodbye(patient=not self._loop.is_own_thread)
            self._dispose()
            return
        with contextlib.suppress(OSError):
            self.speaker.shutdown()  # its driver wakes up, and closes it

    def abandon(self) -> None:
        """In a child process of fork: let go of the socket, and say nothing."""
        self._lock = threading.Lock()  # another thread may have had it locked in the parent process
        self._changed = threading.Condition(self._lock)
        self.closed = True
        self._dispose()

    def _dispose(self) -> None:
        """Close the socket; only its driver does that."""
        with self._lock:
            self.counters.drop("lost", self._pending.clear())
            self._changed.notify_all()
        self.speaker.close()
        if lost := self.counters.dropped["lost"]:
            _log.info("%s -> %s ended with %d messages that were not sent", self.route.source, self.route.target, lost)

    def _fail(self) -> None:
        """The peer is gone."""
        with self._lock:
            told = self.closed
            if self._current is not None and not self._current.done:
                self.counters.drop("lost")
        try:
            if not told:
                self._lost(self)  # before anybody finds it closed: nobody is to find this connection in the list then
        finally:
            with self._lock:
                self.closed = True
            self._dispose()
