"""Established input connections: each waits on the shared thread for its first bytes, then gets its own thread."""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading

from yarp_compat.overriding import override
from yarp_compat.ports.base import MessageCounters, PortBase, dialect_of
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.message import Payload, PortMessage
from yarp_compat.ports.sockets import send_all
from yarp_compat.ports.stream import ByteStream
from yarp_compat.wire import framing
from yarp_compat.wire.carriers import Opening
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import ACK, acknowledgment
from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
EMPTY = b"\x00\x01\x00\x00\x00\x00\x00\x00"  # an empty Bottle


class Input:
    """One input connection, whose peer has introduced itself; subclasses handle its bytes.

    The messages of one connection are handled in sequence, each after the port's owner is done with the previous one;
    so a sender that waits for acknowledgments is as slow as the owner. ``received`` has the bytes that followed the
    introduction; ``greeting`` is the answer to the introduction, if it is still to be sent.
    """

    def __init__(
        self, port: PortBase, sock: socket.socket, opened: Opening, received: bytes, address: tuple[str, int],
        greeting: bytes = b"",
    ) -> None:  # fmt: skip
        self.port = port
        self.route = ConnectionRoute(opened.sender, port.name, opened.carrier.name)
        self.carrier = opened.carrier
        self.address = address
        self.profile: Profile | None = port.profile if opened.carrier.text else None  # the dialect of lines
        self.counters = MessageCounters()
        self.sock = sock
        sock.setblocking(True)
        self.stream = ByteStream(sock, received, port.limit)
        self._has_bytes = bool(received)
        self._greeting = greeting
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()
        self._closing = False
        self._waiting: PortMessage | None = None

    def start(self, loop: PortLoop) -> None:
        """Wait for the first bytes; the connection gets its own thread when they arrive."""
        if self._has_bytes or self._greeting:
            self._begin()
        else:
            loop.call_soon(lambda: self._await(loop))

    def _await(self, loop: PortLoop) -> None:
        def ready() -> None:
            loop.unwatch(self.sock)
            if self._closing:
                self._end()
            else:
                self._on_bytes(loop)

        try:
            loop.watch(self.sock, ready)
        except (OSError, ValueError):  # more sockets than the system's select can watch
            self._begin()

    def _on_bytes(self, loop: PortLoop) -> None:  # noqa: ARG002 - for subclasses
        """Handle the first bytes after `_await`; called on the shared thread."""
        self._begin()

    def _begin(self) -> None:
        name = f"yarp {self.route.source} > {self.port.name}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        try:
            self._thread.start()
        except RuntimeError as error:  # the system is out of threads
            _log.warning("port %s: cannot read the connection from %s: %s", self.port.name, self.route.source, error)
            self._thread = None
            self._end()

    def close(self) -> None:
        """Begin to close the connection; the reply to the message that the owner is handling is still sent."""
        self._closing = True
        waiting = self._waiting
        if waiting is not None and waiting.retire():
            self._stop_reading()
        else:
            self.wake()

    @property
    def is_gone(self) -> bool:
        """Whether the peer has closed the connection; valid only while the peer waits for a reply."""
        try:
            if not hasattr(socket, "MSG_DONTWAIT"):
                return bool(select.select([self.sock], [], [], 0)[0]) and not self.sock.recv(1, socket.MSG_PEEK)
            return not self.sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except (BlockingIOError, ValueError):
            return False
        except OSError:
            return True

    def retire(self) -> None:
        """End the connection after the messages already received."""
        self._stop_reading()

    def _stop_reading(self) -> None:
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RD)

    def abandon(self) -> None:
        """Close the socket of a connection that has no thread."""
        self.sock.close()
        self._ended.set()

    def wake(self) -> None:
        """Wake up threads that wait for bytes: the connection has ended."""
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)

    def join(self, seconds: float) -> None:
        """Wait until the connection has ended."""
        if self._thread is not threading.current_thread():
            if not self._ended.wait(seconds):
                self.wake()
            if self._thread is not None:
                self._thread.join(seconds)

    def _end(self) -> None:
        self.sock.close()
        self.port.ended(self)
        self._ended.set()

    def _run(self) -> None:
        try:
            if self._greeting:
                self._greet()
            if self.handle_messages():
                self.port.ended(self, self.sock)
                self._ended.set()
                return
        except Exception as error:
            self._report(error)
        self._end()

    def _report(self, error: Exception) -> None:
        """Log why the connection ends, and count a malformed message."""
        if isinstance(error, WireError):
            self.counters.refuse(error)
            self.port.refused(self.route, error)
        elif not isinstance(error, OSError):
            _log.error("connection %s -> %s failed", self.route.source, self.route.target, exc_info=error)
        elif not self._closing:
            _log.debug("connection %s -> %s lost: %s", self.route.source, self.route.target, error)

    def _greet(self) -> None:
        """Query the peer's dialect, then answer its introduction; the peer sends nothing before the answer.

        Later, while a request is pending, a C++ port answers no queries (``PortCore::sendHelper`` holds the lock).
        """
        self.profile = dialect_of(self.port.naming, self.route.source)
        self.sock.sendall(self._greeting)

    def handle_messages(self) -> bool:
        """Handle messages until the end; return True if the peer asked to reverse the connection."""
        raise NotImplementedError

    def deliver(self, message: PortMessage) -> Payload:
        """Pass a request to the port's owner and return the reply. Call `reply_sent` when it is sent."""
        self._waiting = message
        self.port.deliver(message)
        reply = message.wait()
        return EMPTY if reply is None else reply

    def reply_sent(self) -> None:
        """Mark the reply as sent."""
        self._waiting = None


class BinaryInput(Input):
    """An input over tcp, fast_tcp or local."""

    @override
    def handle_messages(self) -> bool:
        next_message, send, deliver = self.stream.message, self.sock.sendall, self.port.deliver
        ack = ACK if self.carrier.ack else b""
        while (parts := next_message()) is not None:
            key, text, payload = parts
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
                self._answer(answer, acknowledgment(message.slack) if ack and message.slack else ack)
                self.reply_sent()
            elif key == "a":
                self._answer(self.port.administer(payload, self), ack)
                continue
            else:
                if key not in ("q", "r"):
                    self.port.execute(framing.PortCommand(key, text))
                if ack:
                    send(ack)
                if key in ("q", "r"):
                    return key == "r"
                continue
            if message.is_last:
                return False
            message = parts = payload = answer = None  # type: ignore[assignment]  # frees a large message's memory
        return False

    def _answer(self, answer: Payload, ack: bytes) -> None:
        if isinstance(answer, bytes):
            self.sock.sendall(answer + ack)
        elif isinstance(answer, (bytearray, memoryview)):
            send_all(self.sock, [answer, ack])
        else:
            send_all(self.sock, [*answer, ack])
