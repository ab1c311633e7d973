"""The socket side of an output connection: messages, acknowledgements, replies, goodbyes."""

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

_STEP = 0.2  # seconds after which a thread that waits for a peer looks whether it still should
_FAREWELL = 0.5  # seconds that a peer has to acknowledge the end of a connection
_CHUNK = 1 << 16
_ACKNOWLEDGEMENTS: dict[Carrier, bytes | tuple[bytes, ...]] = {
    carriers.TCP: framing.ACK,
    carriers.TEXT_ACK: b"<ACK>\r\n",
}
_FAREWELLS = {carriers.TEXT: b"q\r\n", carriers.TEXT_ACK: b"q\r\n", carriers.HTTP: http.STREAM_END}


class OutputSocket:
    """An output's socket, for its driver; what is ``patient`` waits, a step at most. ``due``: an acknowledgement is."""

    def __init__(self, sock: socket.socket, route: ConnectionRoute, carrier: Carrier, limit: int) -> None:
        sock.setblocking(False)
        self.sock = sock
        # the same socket once more, with a time-out: reads and writes on it wait
        self._patient = socket.socket(sock.family, sock.type, sock.proto, fileno=sock.fileno())
        self._patient.settimeout(_STEP)
        self._route, self._carrier, self._limit = route, carrier, limit
        self.due = False
        self._came = b""

    def send(self, item: Item, *, patient: bool = False) -> bool:
        """Send what the socket takes of a message; whether that was all."""
        sock = self._patient if patient else self.sock
        buffers = item.buffers
        try:
            while buffers:
                if len(buffers) == 1:
                    count = sock.send(buffers[0])
                    if count == len(buffers[0]):
                        break
                else:
                    count = send_some(sock, buffers)
                buffers = item.buffers = sent(buffers, count)
        except (BlockingIOError, TimeoutError):
            return False
        item.buffers = []
        self.due = self._carrier.ack
        return True

    def take_ack(self, *, patient: bool = False) -> bool:
        """Take the acknowledgement that is due; False where it has not come."""
        sock = self._patient if patient else self.sock
        while True:
            if self._came and (end := _ack_end(self._came, self._carrier)):
                self._came = self._came[end:]
                self.due = False
                return True
            try:
                came = sock.recv(_CHUNK)
            except (BlockingIOError, TimeoutError):
                return False
            if came == framing.ACK and not self._came and not self._carrier.text:
                self.due = False  # as nearly always
                return True
            if not came:
                raise ConnectionResetError(self.gone())
            self._came += came

    def reply(self, watch: ReplyWatch, check_time: Callable[[], None]) -> bytes | None:
        """Wait for the reply, whose end ``watch`` knows; None where the acknowledgement comes without one.

        Raises `ConnectionError`, `WireError` for no Bottle or one above the limit, and what ``check_time`` raises when
        late.
        """
        came: bytes | bytearray = self._came
        acknowledgement = _ACKNOWLEDGEMENTS.get(self._carrier, ())
        while not came.startswith(acknowledgement):
            if end := watch.end(came):
                break
            if len(came) > self._limit + _CHUNK:
                raise WireError(f"a reply from {self._route.target} is larger than {self._limit} bytes")
            try:
                more = self._patient.recv(_CHUNK if len(came) < _CHUNK else 1 << 20)
            except TimeoutError:
                watch.pause()
                check_time()
                continue
            if not more:
                raise ConnectionResetError(self.gone())
            if came:
                check_time()
                came = came if isinstance(came, bytearray) else bytearray(came)
                came += more
            else:
                came = more
        else:
            self._came = bytes(came)
            return None
        self._came = bytes(came[end:])
        return bytes(came[:end])

    def look(self) -> bool:
        """Whether the peer is still there, while nothing is on its way; raises `OSError` where it is not in order."""
        try:
            if self.due:
                self.take_ack()
                return True
            return bool(self.sock.recv(_CHUNK))
        except BlockingIOError:
            return True

    def say_goodbye(self, *, patient: bool) -> None:
        """Announce that no message will come any more."""
        if self.due and not self.take_ack():
            return
        self.sock.send(_FAREWELLS.get(self._carrier, framing.QUIT))
        if self._carrier.ack and patient:
            end = time.monotonic() + _FAREWELL
            while not self.take_ack(patient=True) and time.monotonic() < end:
                pass

    def gone(self) -> str:
        """The error text of a closed connection."""
        return f"the connection from {self._route.source} to {self._route.target} is closed"

    def shutdown(self) -> None:
        """Wake up who waits for the peer; any thread may."""
        self.sock.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the socket."""
        self._patient.detach()
        self.sock.close()


def _ack_end(came: bytes, carrier: Carrier) -> int:
    """The end of the acknowledgement that begins there; 0 where it is not whole."""
    if carrier.text:
        return came.find(b"\n") + 1
    if len(came) < len(framing.ACK):
        return 0
    length = framed(came)
    if length is None or not 0 <= length <= _CHUNK:
        raise ConnectionResetError(f"no acknowledgement: {came[:16]!r}")
    end = len(framing.ACK) + length
    return end if len(came) >= end else 0
