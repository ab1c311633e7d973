"""Connections of udp."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from yarp_compat.ports.counters import Counters
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.message import Message
from yarp_compat.ports.waiting import Item
from yarp_compat.wire import carriers, message
from yarp_compat.wire.contact import Route
from yarp_compat.wire.datagrams import Assembler, split
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.header import Opening
from yarp_compat.wire.message import Buffer

if TYPE_CHECKING:
    from yarp_compat.ports.port import PortCore
    from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
_LARGEST = 1 << 16
_ROOM = 4 << 20
"""Bytes of datagrams that the system is asked to keep for a busy reader."""


def datagram_socket(like: socket.socket) -> socket.socket:
    """A socket for the datagrams of a peer that called at ``like``."""
    made = socket.socket(like.family, socket.SOCK_DGRAM)
    try:
        with contextlib.suppress(OSError):
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _ROOM)
        made.bind((like.getsockname()[0], 0))
    except BaseException:
        made.close()
        raise
    return made


class DatagramInput(Input):
    """An input of udp. Datagrams from other machines than the one that called are not looked at."""

    def __init__(self, port: PortCore, sock: socket.socket, opened: Opening, address: tuple[str, int]) -> None:
        super().__init__(port, sock, opened, b"", address)
        self._assembler = Assembler(port.limit)

    def _no_more(self) -> None:
        self._closing = True
        self.wake()

    def wake(self) -> None:
        """Let whoever waits for datagrams see the connection's end."""
        with contextlib.suppress(OSError), socket.socket(self.sock.family, socket.SOCK_DGRAM) as sock:
            sock.sendto(b"", self.sock.getsockname())

    def take(self) -> bool:
        """Take messages until the connection is closed."""
        memory = memoryview(bytearray(_LARGEST))
        while not self._closing:
            try:
                size, sender = self.sock.recvfrom_into(memory)
            except ConnectionResetError:
                continue  # Windows tells so of datagrams that we sent
            if sender[0] != self.address[0]:
                continue
            try:
                found = self._assembler.add(memory[:size])
                ended = found is not None and self._message(found)
            except WireError as error:
                self.counters.dropped["malformed"] += 1
                self.port.counters.dropped["malformed"] += 1
                _log.debug("datagrams from %s: %s", self.route.source, error)
                continue
            self.counters.dropped["checksum"] = self._assembler.spoiled
            self.counters.dropped["incomplete"] = self._assembler.incomplete
            if ended:
                break
        return False

    def _message(self, data: bytes) -> bool:
        """Take a whole message; whether it was the last."""
        word, payload = message.parse(data, self.port.limit)
        if word.key in ("d", "D"):
            self.counters.received += 1
            found = Message(payload, word.envelope, self)
            self.port.deliver(found)
            return found.is_last
        return word.key == "q"


class DatagramOutput:
    """An output of udp: what the system does not take at once is lost.

    Args:
        sock: connected.
        route: the connection's names.
        lost: told when the peer is gone.
    """

    carrier = carriers.UDP

    def __init__(self, sock: socket.socket, route: Route, lost: Callable[[DatagramOutput], None]) -> None:
        self.route = route
        self.profile: Profile | None = None
        self.counters = Counters()
        self.closed = False
        self.busy = False
        self._sock = sock
        self._lost = lost
        self._lock = threading.Lock()
        sock.setblocking(False)

    def begin(self, buffers: Sequence[Buffer], strict: bool, wait: bool) -> Item | None:
        """Send a message; None where it was dropped."""
        del strict, wait
        failed: OSError | None = None
        with self._lock:
            if self.closed:
                return None
            try:
                for datagram in split(buffers):
                    self._sock.send(datagram)
            except BlockingIOError:
                self.counters.dropped["full"] += 1
                return None
            except OSError as error:
                failed = error
        if failed is not None:
            self._fail(failed)
            return None
        self.counters.sent += 1
        item = Item([], ours=False)
        item.done = True
        return item

    def finish(self, item: Item, deadline: float | None = None) -> bool:
        """Nobody acknowledges datagrams."""
        del deadline
        return item.done

    def leave(self, item: Item) -> None:
        """Nobody waits here."""

    def request(self, *_: object) -> bytes:
        """Datagrams carry no replies."""
        msg = f"udp carries no replies: connect {self.route.source} to {self.route.target} by tcp"
        raise ConnectionRefusedError(msg)

    def wait_idle(self, deadline: float | None) -> bool:
        """Nothing waits here."""
        del deadline
        return True

    def check(self) -> None:
        """Look whether the peer's machine has refused datagrams."""
        with self._lock:
            if self.closed:
                return
            failed: OSError | None = None
            try:
                self._sock.recv(_LARGEST)
            except BlockingIOError:
                return
            except OSError as error:
                failed = error
        if failed is not None:
            self._fail(failed)

    def close(self) -> None:
        """Close it; the peer does not notice, and is to be told otherwise."""
        with self._lock:
            self.closed = True
            self._sock.close()

    def abandon(self) -> None:
        """Let go of the socket."""
        self._sock.close()

    def _fail(self, error: OSError) -> None:
        if isinstance(error, ConnectionError):
            self._lost(self)
            self.close()
        else:
            self.counters.dropped["full"] += 1
            _log.debug("udp to %s: %s", self.route.target, error)
