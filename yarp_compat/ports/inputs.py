"""An established input connection: waits on the shared thread for its first bytes, then has a thread of its own."""

from __future__ import annotations

import contextlib
import logging
import select
import selectors
import socket
import threading

from yarp_compat.ports.base import MessageCounters, PortBase, dialect_of
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.message import Payload, PortMessage
from yarp_compat.ports.sockets import send_all
from yarp_compat.ports.stream import ByteStream
from yarp_compat.wire import framing
from yarp_compat.wire.carriers import Opening
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import ACK, acknowledgement
from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
EMPTY = b"\x00\x01\x00\x00\x00\x00\x00\x00"  # a Bottle with nothing in it


class Input:
    """One input connection, whose peer has introduced itself; subclasses handle its bytes.

    The messages of one connection are taken one after another, each when the port's owner is done with the one before;
    so a sender that waits for acknowledgements goes no faster than the owner. ``already`` came behind the introduction;
    ``greeting`` answers that, where the peer has not got it yet.
    """

    def __init__(
        self, port: PortBase, sock: socket.socket, opened: Opening, already: bytes, address: tuple[str, int],
        greeting: bytes = b"",
    ) -> None:  # fmt: skip
        self.port = port
        self.route = ConnectionRoute(opened.sender, port.name, opened.carrier.name)
        self.carrier = opened.carrier
        self.address = address
        self.profile: Profile | None = port.profile if opened.carrier.text else None  # lines become that port's Bottles
        self.counters = MessageCounters()
        self.sock = sock
        sock.setblocking(True)
        self.stream = ByteStream(sock, already, port.limit)
        self._already = bool(already)
        self._greeting = greeting
        self._thread: threading.Thread | None = None
        self._over = threading.Event()
        self._closing = False
        self._waiting: PortMessage | None = None

    def start(self, loop: PortLoop) -> None:
        """Wait for the first bytes; only a connection that says something gets a thread."""
        if self._already or self._greeting:
            self._begin()
        else:
            loop.call(lambda: self._await(loop))

    def _await(self, loop: PortLoop) -> None:
        def ready(_: int) -> None:
            loop.ignore(self.sock)
            if self._closing:
                self._end()
            else:
                self._begin()

        try:
            loop.watch(self.sock, selectors.EVENT_READ, ready)
        except ValueError:  # more than the system's select can watch
            self._begin()

    def _begin(self) -> None:
        name = f"yarp {self.route.source} > {self.port.name}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the connection soon; the reply to a message that the owner has at this moment is still sent."""
        self._closing = True
        waiting = self._waiting
        if waiting is not None and waiting.retire():
            self._no_more()
        else:
            self.wake()

    @property
    def is_gone(self) -> bool:
        """Whether the peer has closed the connection; only asked while it waits for a reply."""
        try:
            if not hasattr(socket, "MSG_DONTWAIT"):
                return bool(select.select([self.sock], [], [], 0)[0]) and not self.sock.recv(1, socket.MSG_PEEK)
            return not self.sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except (BlockingIOError, ValueError):
            return False
        except OSError:
            return True

    def retire(self) -> None:
        """End the connection when what has come of it is read."""
        self._no_more()

    def _no_more(self) -> None:
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RD)

    def abandon(self) -> None:
        """Close the socket, where no thread has it yet, or none any more."""
        self.sock.close()
        self._over.set()

    def wake(self) -> None:
        """Wake threads that wait for bytes: the connection has ended."""
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)

    def join(self, seconds: float) -> None:
        """Wait until the connection has ended."""
        if self._thread is not threading.current_thread():
            if not self._over.wait(seconds):
                self.wake()
            if self._thread is not None:
                self._thread.join(seconds)

    def _end(self) -> None:
        self.sock.close()
        self.port.ended(self)
        self._over.set()

    def _run(self) -> None:
        try:
            if self._greeting:
                self._greet()
            if self.take():
                self.port.ended(self, self.sock)
                self._over.set()
                return
        except WireError as error:
            self.counters.refuse(error)
            self.port.refused(self.route, error)
        except OSError as error:
            if not self._closing:
                _log.debug("connection %s -> %s broke: %s", self.route.source, self.route.target, error)
        except Exception:
            _log.exception("connection %s -> %s failed", self.route.source, self.route.target)
        self._end()

    def _greet(self) -> None:
        """Ask the port that calls for its dialect, and answer it: before that it cannot send.

        Later, with a request on its way, a C++ port would answer nobody else (``PortCore::sendHelper`` has the lock).
        """
        self.profile = dialect_of(self.port.naming, self.route.source)
        self.sock.sendall(self._greeting)

    def take(self) -> bool:
        """Take messages until the end; True where the connection is to be turned round."""
        raise NotImplementedError

    def deliver(self, message: PortMessage) -> Payload:
        """Give a message that wants a reply to the port's owner; returns the reply. Call `answered` when it is sent."""
        self._waiting = message
        self.port.deliver(message)
        reply = message.wait()
        return EMPTY if reply is None else reply

    def answered(self) -> None:
        """The reply is sent."""
        self._waiting = None


class BinaryInput(Input):
    """An input of tcp, fast_tcp or local."""

    def take(self) -> bool:
        """Take messages until the end; True where the connection is to be turned round."""
        next_message, send, deliver = self.stream.message, self.sock.sendall, self.port.deliver
        ack = ACK if self.carrier.ack else b""
        while (found := next_message()) is not None:
            key, text, payload = found
            if key == "D":
                self.counters.received += 1
                message = PortMessage(payload, text[2:], self)
                deliver(message)
                if ack:
                    send(ack)
            elif key == "d":
                self.counters.received += 1
                message = PortMessage(payload, text[2:], self, wants_reply=True)
                answer = self.deliver(message)
                self._answer(answer, acknowledgement(message.slack) if ack and message.slack else ack)
                self.answered()
            elif key == "a":
                self._answer(self.port.administer(payload, self), ack)
                continue
            else:
                if key not in ("q", "r"):
                    self.port.obey(framing.PortCommand(key, text))
                if ack:
                    send(ack)
                if key in ("q", "r"):
                    return key == "r"
                continue
            if message.is_last:
                return False
            message = found = payload = answer = None  # type: ignore[assignment]  # so a large one's memory can be used again
        return False

    def _answer(self, answer: Payload, ack: bytes) -> None:
        if isinstance(answer, bytes):
            self.sock.sendall(answer + ack)
        elif isinstance(answer, (bytearray, memoryview)):
            send_all(self.sock, [answer, ack])
        else:
            send_all(self.sock, [*answer, ack])
