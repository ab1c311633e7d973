"""The socket of an output connection: messages, acknowledgments, replies, and the end."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

from yarp_compat.ports.outgoing import Item
from yarp_compat.ports.sockets import send_some, sent
from yarp_compat.wire import carriers, framing, http
from yarp_compat.wire.carriers import Carrier, framed
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.reply import ReplyWatch

_STEP = 0.2  # seconds between checks of whether a waiting thread should stop
_FAREWELL = 0.5  # seconds for a peer to acknowledge the end of a connection
_CHUNK = 1 << 16
_ACKNOWLEDGMENTS: dict[Carrier, bytes | tuple[bytes, ...]] = {
    carriers.TCP: framing.ACK,
    carriers.TEXT_ACK: b"<ACK>\r\n",
}
_FAREWELLS = {carriers.TEXT: b"q\r\n", carriers.TEXT_ACK: b"q\r\n", carriers.HTTP: http.STREAM_END}


class OutputSocket:
    """An output's socket, for its driver. ``patient`` calls block up to one step; ``due``: an ack is outstanding.

    ``sent_bytes``: the number of bytes of messages that the system has accepted.
    """

    def __init__(self, sock: socket.socket, route: ConnectionRoute, carrier: Carrier, limit: int) -> None:
        sock.setblocking(False)
        self.sock = sock
        # the same descriptor with a timeout: reads and writes block
        self._patient = socket.socket(sock.family, sock.type, sock.proto, fileno=sock.fileno())
        self._patient.settimeout(_STEP)
        self._route, self._carrier, self._limit = route, carrier, limit
        self.due = False
        self.sent_bytes = 0
        self._received = b""

    def send(self, item: Item, *, patient: bool = False) -> bool:
        """Send as much of a message as the socket accepts; return whether it is all sent."""
        sock = self._patient if patient else self.sock
        buffers = item.buffers
        try:
            while buffers:
                if len(buffers) == 1:
                    count = sock.send(buffers[0])
                    self.sent_bytes += count
                    if count == len(buffers[0]):
                        break
                else:
                    count = send_some(sock, buffers)
                    self.sent_bytes += count
                buffers = item.buffers = sent(buffers, count)
        except (BlockingIOError, TimeoutError):
            return False
        item.buffers = []
        self.due = self._carrier.ack
        return True

    def read_ack(self, *, patient: bool = False) -> bool:
        """Read the outstanding acknowledgment; return False if it has not arrived."""
        sock = self._patient if patient else self.sock
        while True:
            if self._received and (end := _ack_end(self._received, self._carrier)):
                self._received = self._received[end:]
                self.due = False
                return True
            try:
                received = sock.recv(_CHUNK)
            except (BlockingIOError, TimeoutError):
                return False
            if received == framing.ACK and not self._received and not self._carrier.text:
                self.due = False  # the usual case
                return True
            if not received:
                raise ConnectionResetError(self.closed_message())
            self._received += received

    def reply(self, watch: ReplyWatch, check_time: Callable[[], None]) -> bytes | None:
        """Wait for the reply, whose end ``watch`` finds; return None if the acknowledgment arrives without one.

        Raises `ConnectionError`, `WireError` for an invalid Bottle or one above the limit, and what ``check_time``
        raises.
        """
        received: bytes | bytearray = self._received
        acknowledgment = _ACKNOWLEDGMENTS.get(self._carrier, ())
        while not received.startswith(acknowledgment):
            if end := watch.end(received):
                break
            if len(received) > self._limit + _CHUNK:
                raise WireError(f"a reply from {self._route.target} is larger than {self._limit} bytes")
            try:
                more = self._patient.recv(_CHUNK if len(received) < _CHUNK else 1 << 20)
            except TimeoutError:
                watch.pause()
                check_time()
                continue
            if not more:
                raise ConnectionResetError(self.closed_message())
            if received:
                check_time()
                received = received if isinstance(received, bytearray) else bytearray(received)
                received += more
            else:
                received = more
        else:
            self._received = bytes(received)
            return None
        self._received = bytes(received[end:])
        return bytes(received[:end])

    def is_connected(self) -> bool:
        """Return whether the peer of an idle connection is still connected; raises `OSError` on errors."""
        try:
            if self.due:
                self.read_ack()
                return True
            return bool(self.sock.recv(_CHUNK))
        except BlockingIOError:
            return True

    def send_farewell(self, *, patient: bool) -> None:
        """Announce the end of the connection."""
        if self.due and not self.read_ack():
            return
        self.sock.send(_FAREWELLS.get(self._carrier, framing.QUIT))
        if self._carrier.ack and patient:
            end = time.monotonic() + _FAREWELL
            while not self.read_ack(patient=True) and time.monotonic() < end:
                pass

    def closed_message(self) -> str:
        """Return the error message for a closed connection."""
        return f"the connection from {self._route.source} to {self._route.target} is closed"

    def shutdown(self) -> None:
        """Wake up the threads that wait for the peer; thread-safe."""
        self.sock.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._patient.detach()
        self.sock.close()


def _ack_end(received: bytes, carrier: Carrier) -> int:
    """Return the end of the acknowledgment at the start of ``received``; 0 if it is incomplete."""
    if carrier.text:
        return received.find(b"\n") + 1
    if len(received) < len(framing.ACK):
        return 0
    length = framed(received)
    if length is None or not 0 <= length <= _CHUNK:
        raise ConnectionResetError(f"invalid acknowledgment: {received[:16]!r}")
    end = len(framing.ACK) + length
    return end if len(received) >= end else 0
