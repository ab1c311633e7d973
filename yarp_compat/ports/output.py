"""An output connection: sends at once where the peer takes it at once, else by the shared thread from a bounded queue."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from yarp_compat.ports.counters import Counters
from yarp_compat.ports.sending import send_some, sent
from yarp_compat.wire import carriers, http, message
from yarp_compat.wire.carriers import Carrier, framed
from yarp_compat.wire.contact import Route
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.reply import ReplyReader, plain_end

if TYPE_CHECKING:
    from yarp_compat.ports.loop import Loop
    from yarp_compat.wire.profile import Profile

_STEP = 0.2
"""Seconds after which a thread that waits for a peer looks whether it still should."""
_FAREWELL = 0.5
"""Seconds that a peer has to acknowledge the end of a connection."""
_CHUNK = 1 << 16
_FAREWELLS = {carriers.TEXT: b"q\r\n", carriers.TEXT_ACK: b"q\r\n", carriers.HTTP: http.STREAM_END}

ReplyEnd = Callable[[Buffer], int]
"""Where a reply ends that stands at the beginning of these bytes; raises Incomplete when more must come."""


class Item:
    """A message on its way out."""

    __slots__ = ("buffers", "done", "ours")

    def __init__(self, buffers: list[Buffer], ours: bool) -> None:
        self.buffers = buffers
        self.done = False
        self.ours = ours
        """The thread that wrote it also sees it through."""


class Output:
    """One output connection on a stream of bytes.

    At any time at most one thread talks on the connection, its driver: a thread that writes, or the shared thread while messages wait.

    Args:
        sock: connected and introduced.
        route: the connection's names.
        carrier: how it carries.
        loop: the shared thread.
        lost: told when the peer is gone.
        limit: bytes of the queue, and of a reply.
    """

    def __init__(
        self,
        sock: socket.socket,
        route: Route,
        carrier: Carrier,
        loop: Loop,
        lost: Callable[[Output], None],
        limit: int,
    ) -> None:
        self.route = route
        self.carrier = carrier
        self.profile: Profile | None = None
        self.counters = Counters()
        self.closed = False
        self._loop = loop
        self._lost = lost
        self._limit = limit
        self._changed = threading.Condition()
        self._pending: deque[Item] = deque()
        self._pending_bytes = 0
        self._driven = False
        self._current: Item | None = None
        self._due = False
        self._came = b""
        sock.setblocking(False)
        self._sock = sock
        # the same socket once more, with a time-out: reads and writes on it wait
        self._patient = socket.socket(sock.family, sock.type, sock.proto, fileno=sock.fileno())
        self._patient.settimeout(_STEP)

    # -- writing ------------------------------------------------------------------------------------------------------

    def begin(self, buffers: Sequence[Buffer], *, strict: bool, wait: bool) -> Item | None:
        """Send a message as far as that goes at once; the rest follows.

        Args:
            buffers: all of its bytes; kept uncopied while ``wait``.
            strict: queue it behind others, else it takes the place of what waits.
            wait: the caller will call :meth:`finish`.

        Returns:
            The message, or None where it was dropped.
        """
        item = Item(list(buffers), wait)
        with self._changed:
            if self.closed:
                return None
            if self._driven:
                return item if self._queue(item, strict) else None
            self._driven = True
        item.ours = wait
        try:
            if (not self._due or self._take_ack(self._sock)) and self._send(item, self._sock):
                if not wait:
                    item.done = True
                    self._current = None
                    self._release()
                return item
        except OSError as error:
            self._fail(error)
            return None
        if self._current is None:
            self._current = item
        if not wait:
            self._hand_over()
        return item

    def finish(self, item: Item, deadline: float | None = None) -> bool:
        """Wait until a message was sent and, where the carrier does that, acknowledged; False where it was not by the deadline."""
        if not item.ours or item is not self._current:
            with self._changed:
                self._changed.wait_for(lambda: item.done or self.closed, _left(deadline))
            return item.done
        try:
            while not self._advance(item):
                if self.closed:
                    self._dispose()
                    return False
                if deadline is not None and time.monotonic() > deadline:
                    self._hand_over()
                    return False
        except OSError as error:
            self._fail(error)
            return False
        item.done = True
        self._current = None
        self._release()
        return True

    def _advance(self, item: Item) -> bool:
        """Wait for a step of a message; whether that was its last."""
        try:
            if item.buffers:
                if self._due and not self._take_ack(self._patient):
                    return False
                self._due = False
                if not self._send(item, self._patient):
                    return False
            return not self._due or self._take_ack(self._patient)
        except TimeoutError:
            return False

    def _send(self, item: Item, sock: socket.socket) -> bool:
        """Send what the socket takes; whether that was all."""
        self._current = item
        buffers = item.buffers
        while buffers:
            try:
                count = send_some(sock, buffers)
            except BlockingIOError:
                item.buffers = buffers
                return False
            buffers = sent(buffers, count) if len(buffers) > 1 or count < len(buffers[0]) else []
        item.buffers = buffers
        self._due = self.carrier.ack
        self.counters.sent += 1
        return True

    def _take_ack(self, sock: socket.socket) -> bool:
        """Take the acknowledgement that is due; False where it has not come."""
        while True:
            end = _ack_end(self._came, self.carrier)
            if end:
                self._came = self._came[end:]
                self._due = False
                return True
            try:
                came = sock.recv(_CHUNK)
            except (BlockingIOError, TimeoutError):
                return False
            if not came:
                msg = "the peer closed the connection"
                raise ConnectionResetError(msg)
            self._came += came

    # -- the queue ----------------------------------------------------------------------------------------------------

    def _queue(self, item: Item, strict: bool) -> bool:
        """Let a message wait for its turn; with the lock held."""
        if not strict and not item.ours:
            self.counters.dropped["replaced"] += len(self._pending)
            self._pending.clear()
            self._pending_bytes = 0
        size = message.size(item.buffers)
        if self._pending and self._pending_bytes + size > self._limit:
            self.counters.dropped["full"] += 1
            return False
        if not item.ours:
            item.buffers = [b"".join(item.buffers)]
        self._pending.append(item)
        self._pending_bytes += size
        return True

    def _hand_over(self) -> None:
        """Let the shared thread go on."""
        if self._current is not None and self._current.buffers:
            self._current.buffers = [b"".join(self._current.buffers)]  # its owner may change them now
        self._loop.call(self._drive)

    def _drive(self, _: int = 0) -> None:
        """Go on with what waits, on the shared thread."""
        try:
            events = self._step()
        except OSError as error:
            self._loop.ignore(self._sock)
            self._fail(error)
            return
        if self.closed:
            self._loop.ignore(self._sock)
            self._dispose()
        elif events:
            self._loop.watch(self._sock, events, self._drive)
        else:
            self._loop.ignore(self._sock)
            self._release()

    def _step(self) -> int:
        while not self.closed:
            if self._due and not self._take_ack(self._sock):
                return selectors.EVENT_READ
            if self._current is not None and self._current.buffers and not self._send(self._current, self._sock):
                return selectors.EVENT_WRITE
            if self._due:
                continue
            with self._changed:
                if self._current is not None:
                    self._current.done = True
                    self._changed.notify_all()
                self._current = self._pending.popleft() if self._pending else None
                if self._current is None:
                    return 0
                self._pending_bytes -= message.size(self._current.buffers)
        return 0

    def _release(self) -> None:
        """Drive no longer: let the shared thread go on with what came meanwhile, if anything did."""
        with self._changed:
            if not self._pending and not self.closed:
                self._driven = False
                self._changed.notify_all()
                return
        if self.closed:
            self._dispose()
        else:
            self._loop.call(self._drive)

    @property
    def busy(self) -> bool:
        """Whether a message is still on its way out."""
        return self._driven or self._due

    def wait_idle(self, deadline: float | None) -> bool:
        """Wait until nothing is on its way any more, acknowledgements included; False where something still is by the deadline."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._driven or self.closed, _left(deadline)):
                return False
            if self.closed or not self._due:
                return True
            self._driven = True
        item = Item([], ours=True)
        self._current = item
        return self.finish(item, deadline)

    # -- requests -----------------------------------------------------------------------------------------------------

    def request(self, buffers: list[Buffer], parse: ReplyEnd | None, deadline: float | None) -> bytes:
        """Send a message that wants a reply, and wait for it.

        Args:
            buffers: all of its bytes.
            parse: where a reply ends; None: a Bottle's end, or with a text carrier the line's.
            deadline: of the monotonic clock.

        Raises:
            TimeoutError: no reply by the deadline; the connection is closed, as the reply may still come.
            ConnectionError: the connection broke.
            WireError: the reply is no Bottle, or above the limit; the connection is closed.
        """
        with self._changed:
            if self._driven:
                self._changed.wait_for(lambda: not self._driven or self.closed, _left(deadline))
            if self.closed:
                msg = f"not connected to {self.route.target}"
                raise ConnectionResetError(msg)
            if self._driven:
                msg = f"{self.route.target} is still busy with another message"
                raise TimeoutError(msg)
            self._driven = True
        item = Item(buffers, True)
        try:
            while (self._due and not self._take_ack(self._patient)) or not self._send_patiently(item):
                self._check_time(deadline)
            self._due = False
            reply = self._reply(parse or (_line_end if self.carrier.text else None), deadline)
            if self.carrier.ack:
                self._due = True
                while not self._take_ack(self._patient):
                    self._check_time(deadline)
        except (OSError, WireError) as error:
            self._fail(error)
            raise
        self._current = None
        self.counters.received += 1
        self._release()
        return reply

    def _send_patiently(self, item: Item) -> bool:
        try:
            return self._send(item, self._patient)
        except TimeoutError:
            return False

    def _check_time(self, deadline: float | None) -> None:
        if self.closed:
            msg = f"the connection to {self.route.target} was closed"
            raise ConnectionAbortedError(msg)
        if deadline is not None and time.monotonic() > deadline:
            msg = f"no reply from {self.route.target} in time"
            raise TimeoutError(msg)

    def _reply(self, parse: ReplyEnd | None, deadline: float | None) -> bytes:
        came: bytes | bytearray = self._came
        reader: ReplyReader | None = None
        looked = 0
        while True:
            if came and len(came) >= looked:
                end = plain_end(came, self.profile) if parse is None else 0
                try:
                    if not 0 < end <= len(came):
                        if parse is None:
                            reader = reader or ReplyReader(self.profile, acked=self.carrier.ack, limit=self._limit)
                            parse = reader.end
                        end = parse(came)
                except Incomplete:
                    # a reader of one's own begins anew each time: a long reply is looked at again when it has grown by half
                    looked = len(came) + len(came) // 2 if reader is None and len(came) > _CHUNK else 0
                else:
                    if reader is not None:
                        self.profile = reader.profile
                    self._came = bytes(came[end:])
                    return bytes(came[:end])
            if len(came) > self._limit + _CHUNK:
                msg = f"a reply from {self.route.target} is larger than {self._limit} bytes"
                raise WireError(msg)
            try:
                more = self._patient.recv(_CHUNK if len(came) < _CHUNK else 1 << 20)
            except TimeoutError:
                self._check_time(deadline)
                looked = 0  # it pauses: perhaps it is all there
                continue
            if not more:
                msg = f"{self.route.target} closed the connection"
                raise ConnectionResetError(msg)
            if deadline is not None and came:
                self._check_time(deadline)
            if came:
                came = came if isinstance(came, bytearray) else bytearray(came)
                came += more
            else:
                came = more

    # -- the end ------------------------------------------------------------------------------------------------------

    def check(self) -> None:
        """Look whether the peer is still there; on the shared thread, now and then, as nothing is read from an idle connection."""
        with self._changed:
            if self._driven or self.closed:
                return
            self._driven = True
        try:
            if self._due:
                self._take_ack(self._sock)
            elif not self._sock.recv(_CHUNK):
                msg = "the peer closed the connection"
                raise ConnectionResetError(msg)
        except BlockingIOError:
            pass
        except OSError as error:
            self._fail(error)
            return
        self._release()

    def close(self) -> None:
        """Say goodbye where the connection is free, and close it."""
        with self._changed:
            if self.closed:
                return
            self.closed = True
            free = not self._driven
            self._driven = True
            self._changed.notify_all()
        if free:
            with contextlib.suppress(OSError):
                self._say_goodbye()
            self._dispose()
            return
        with contextlib.suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)  # its driver wakes up, and closes it
        self._loop.call(self._dispose_if_watched)

    def abandon(self) -> None:
        """Let go of the socket, and say nothing."""
        self._changed = threading.Condition()  # another thread may have had it locked in the parent process
        self.closed = True
        self._dispose()

    def _say_goodbye(self) -> None:
        if self._due and not self._take_ack(self._sock):
            return
        self._sock.send(_FAREWELLS.get(self.carrier, message.QUIT))
        if self.carrier.ack and not self._loop.is_own_thread:
            self._due = True
            end = time.monotonic() + _FAREWELL
            while not self._take_ack(self._patient) and time.monotonic() < end:
                pass

    def _dispose_if_watched(self) -> None:
        if self._loop.ignore(self._sock):
            self._dispose()

    def _dispose(self) -> None:
        """Close the socket; only its driver does that."""
        with self._changed:
            self.counters.dropped["lost"] += len(self._pending)
            self._pending.clear()
            self._pending_bytes = 0
            self._changed.notify_all()
        with contextlib.suppress(OSError):
            self._patient.detach()
        self._sock.close()

    def _fail(self, error: Exception) -> None:
        """The peer is gone."""
        del error
        with self._changed:
            told = self.closed
            self.closed = True
            if self._current is not None and not self._current.done:
                self.counters.dropped["lost"] += 1
        self._dispose()
        if not told:
            self._lost(self)


def _left(deadline: float | None) -> float | None:
    return None if deadline is None else max(0.0, deadline - time.monotonic())


def _line_end(came: Buffer) -> int:
    found = bytes(came).find(b"\n")
    if found < 0:
        raise Incomplete("a line ends early")
    return found + 1


def _ack_end(came: bytes, carrier: Carrier) -> int:
    """Where the acknowledgement ends that begins there; 0 where it is not whole."""
    if carrier.text:
        return came.find(b"\n") + 1
    if len(came) < len(message.ACK):
        return 0
    length = framed(came)
    if length is None or not 0 <= length <= _CHUNK:
        msg = f"no acknowledgement: {came[:16]!r}"
        raise ConnectionResetError(msg)
    end = len(message.ACK) + length
    return end if len(came) >= end else 0
