"""Connections over udp, and the base classes for mcast."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections import Counter
from collections.abc import Callable, Sequence

from yarp_compat.overriding import override
from yarp_compat.ports.base import MessageCounters, PortBase
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.outgoing import Item
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.wire import carriers, framing
from yarp_compat.wire.carriers import Group, Opening
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.datagrams import Assembler, split
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
_LARGEST = 1 << 16
RECEIVE_BUFFER = 4 << 20  # requested receive buffer in bytes, for busy readers
_HOPS = 1  # like those of YARP's ports, datagrams do not cross routers


def datagram_socket(like: socket.socket) -> socket.socket:
    """Return a socket for the datagrams of a peer that connected to ``like``."""
    sock = socket.socket(like.family, socket.SOCK_DGRAM)
    with closed_on_failure(sock):
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        sock.bind((like.getsockname()[0], 0))
    return sock


class DatagramInput(Input):
    """An input of datagrams. Datagrams from machines other than the peer's are ignored."""

    def __init__(self, port: PortBase, sock: socket.socket, opened: Opening, address: tuple[str, int]) -> None:
        super().__init__(port, sock, opened, b"", address)
        self._assembler = Assembler(port.limit)

    def _assembler_of(self, sender: tuple[str, int]) -> Assembler:  # noqa: ARG002
        return self._assembler

    @override
    def _stop_reading(self) -> None:
        self._closing = True
        self.wake()

    @override
    def wake(self) -> None:
        with contextlib.suppress(OSError), socket.socket(self.sock.family, socket.SOCK_DGRAM) as sock:
            sock.sendto(b"", self.sock.getsockname())

    def _receive(self, memory: memoryview) -> tuple[int, tuple[str, int]]:
        """Wait for a datagram; return its size and its sender."""
        size, sender = self.sock.recvfrom_into(memory)
        return size, sender

    @override
    def handle_messages(self) -> bool:
        memory = memoryview(bytearray(_LARGEST))
        while not self._closing:
            try:
                size, sender = self._receive(memory)
            except ConnectionResetError:
                continue  # Windows reports this for datagrams that this port sent
            if sender[0] != self.address[0]:
                continue
            assembler = self._assembler_of(sender)
            try:
                message = assembler.add(memory[:size])
                ended = message is not None and self._message(message)
            except WireError as error:
                self.counters.refuse(error)
                self.port.counters.refuse(error)
                _log.debug("datagrams from %s: %s", self.route.source, error)
                continue
            self._count(assembler)
            if ended:
                break
        return False

    def _count(self, assembler: Assembler) -> None:
        self.counters.dropped["checksum"] = assembler.spoiled
        self.counters.dropped["incomplete"] = assembler.incomplete

    def _message(self, data: bytes) -> bool:
        """Handle a complete message; return whether it was the last."""
        command, payload = framing.parse(data, self.port.limit)
        if command.key in ("d", "D"):
            self.counters.received += 1
            message = PortMessage(payload, command.envelope, self)
            self.port.deliver(message)
            return message.is_last
        return command.key == "q"


class SendingGroup:
    """A multicast group that a port writes to from one interface; ``lock`` keeps datagrams of a message together."""

    def __init__(self, name: str, address: Group, interface: str) -> None:
        self.name, self.address, self.interface = name, address, interface
        self.lock = threading.Lock()
        self.profile: Profile | None = None
        self.readers = 0
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with closed_on_failure(self._sock):
            self._sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))
            self._sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, _HOPS)
            self._sock.connect(address)

    def socket(self) -> socket.socket:
        """Return a duplicate of the socket, so that each output can close its own."""
        return self._sock.dup()

    def close(self) -> None:
        """Close the socket; the outputs' duplicates stay open."""
        self._sock.close()


class DatagramOutput:
    """An output over udp or mcast; outputs may share a ``group``. Datagrams that cannot be sent at once are dropped.

    ``lost`` is called when the peer is unreachable; ``dropped`` counts the port's drops.
    """

    def __init__(
        self,
        sock: socket.socket,
        route: ConnectionRoute,
        lost: Callable[[DatagramOutput], object],
        group: SendingGroup | None = None,
        dropped: Counter[str] | None = None,
    ) -> None:
        self.route = route
        self.group = group
        self.carrier = carriers.UDP if group is None else carriers.MCAST
        self.profile: Profile | None = None
        self.counters = MessageCounters(whole=dropped)
        self.closed = False
        self.busy = False
        self.sock = sock  # for its options; only this object sends
        self._lost = lost
        self._lock = threading.Lock() if group is None else group.lock
        sock.setblocking(False)

    def begin(self, buffers: Sequence[Buffer], strict: bool, wait: bool) -> Item | None:  # noqa: ARG002
        """Send a message; return None if it was dropped or the output is closed."""
        failed: OSError | None = None
        with self._lock:
            if self.closed:
                return None
            try:
                for datagram in split(buffers):
                    self.sock.send(datagram)
            except BlockingIOError:
                self.counters.drop("full")
                return None
            except OSError as error:
                failed = error
        if failed is not None:
            self._fail(failed)
            return None
        self.counters.sent += 1
        return Item([], writer_completes=False, done=True)

    def finish(self, item: Item, deadline: float | None = None) -> bool:  # noqa: ARG002
        """Return at once: datagrams are not acknowledged."""
        return item.done

    def detach(self, item: Item) -> None:
        """Do nothing: a message is sent or dropped at once."""

    def request(self, *_: object) -> bytes:
        """Raise `ConnectionRefusedError`: datagrams carry no replies."""
        msg = f"{self.carrier.name} carries no replies: connect {self.route.source} to {self.route.target} over tcp"
        raise ConnectionRefusedError(msg)

    def wait_idle(self, deadline: float | None) -> bool:  # noqa: ARG002
        """Return at once: no message is queued."""
        return True

    def check(self) -> None:
        """Close the output if the peer's machine has rejected datagrams."""
        with self._lock:
            if self.closed:
                return
            failed: OSError | None = None
            try:
                self.sock.recv(_LARGEST)
            except BlockingIOError:
                return
            except OSError as error:
                failed = error
        if failed is not None:
            self._fail(failed)

    def close(self) -> None:
        """Close the socket; the peer does not notice, so the caller has to notify it."""
        with self._lock:
            self.closed = True
            self.sock.close()

    def abandon(self) -> None:
        """Close the socket in a forked child process."""
        self.sock.close()

    def _fail(self, error: OSError) -> None:
        if isinstance(error, ConnectionError) and self.group is None:  # a group outlives one of its readers
            self._lost(self)
            self.close()
        else:
            self.counters.drop("full")
            _log.debug("%s to %s: %s", self.carrier.name, self.route.target, error)
