"""An established input: a thread that takes one connection's messages."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from typing import TYPE_CHECKING

from yarp_compat.ports.counters import Counters
from yarp_compat.ports.message import Message, Payload
from yarp_compat.ports.sending import send_all
from yarp_compat.ports.stream import Stream
from yarp_compat.wire import carriers, command
from yarp_compat.wire.contact import Route
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.header import Opening
from yarp_compat.wire.message import ACK, Buffer

if TYPE_CHECKING:
    from yarp_compat.ports.port import PortCore
    from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
_TEXT_ACK = b"<ACK>\r\n"
EMPTY = b"\x00\x01\x00\x00\x00\x00\x00\x00"
"""A Bottle with nothing in it."""


class Input:
    """One input connection on a stream of bytes: binary (tcp, fast_tcp, local) or text (text, text_ack).

    The messages of one connection are taken one after another, each when the port's owner is done with the one before; so a sender that
    waits for acknowledgements goes no faster than the owner.
    """

    def __init__(self, port: PortCore, sock: socket.socket, opened: Opening, already: bytes) -> None:
        self.port = port
        self.route = Route(opened.sender, port.name, opened.carrier.name)
        self.carrier = opened.carrier
        self.profile: Profile | None = None
        self.counters = Counters()
        self._sock = sock
        self._stream = Stream(sock, already, port.limit)
        self._thread: threading.Thread | None = None
        self._closing = False
        self._waiting: Message | None = None

    def start(self) -> None:
        """Begin to take messages."""
        self._thread = threading.Thread(
            target=self._run, name=f"yarp {self.route.source} to {self.route.target}", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """End the connection; its thread ends soon."""
        self._closing = True
        with contextlib.suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)
        if (waiting := self._waiting) is not None:
            waiting.give_up()

    def join(self, seconds: float) -> None:
        """Wait until the connection's thread has ended."""
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(seconds)

    def _run(self) -> None:
        try:
            turned = self._take_text() if self.carrier.text else self._take_binary()
            if turned:
                self.port.turned(self, self._sock)
                return
        except WireError as error:
            self.counters.dropped["malformed"] += 1
            self.port.refused(self.route, error)
        except OSError as error:
            if not self._closing:
                _log.debug("connection %s -> %s broke: %s", self.route.source, self.route.target, error)
        except Exception:
            _log.exception("connection %s -> %s failed", self.route.source, self.route.target)
        self._sock.close()
        self.port.ended(self)

    def _take_binary(self) -> bool:
        """Take messages until the end; True where the connection is to be turned round."""
        next_message, acknowledged, deliver = self._stream.message, self.carrier.ack, self.port.deliver
        while (found := next_message()) is not None:
            key, text, payload = found
            answer: Payload = b""
            if key in ("D", "d"):
                message = Message(payload, text[2:], self, key == "d")
                self.counters.received += 1
                answer = self._deliver(message) if key == "d" else deliver(message) or b""
            elif key == "q":
                if acknowledged:
                    self._sock.sendall(ACK)
                return False
            elif key == "r":
                if acknowledged:
                    self._sock.sendall(ACK)
                return True
            elif key == "a":
                answer = self.port.administer(payload, self)
            else:
                self.port.obey(command.PortCommand(key, text), self)
            if acknowledged or answer:
                self._answer(answer, ACK if acknowledged else b"")
            message = found = payload = None  # type: ignore[assignment]  # the memory of a large message is used again
        return False

    def _deliver(self, message: Message) -> Payload:
        """Give a message to the port's owner; the reply it wants."""
        self._waiting = message
        self.port.deliver(message)
        reply = message.wait()
        self._waiting = None
        return EMPTY if reply is None else reply

    def _answer(self, answer: Payload, ack: bytes) -> None:
        if isinstance(answer, bytes):
            self._sock.sendall(answer + ack)
        elif isinstance(answer, (bytearray, memoryview)):
            send_all(self._sock, [answer, ack])
        else:
            send_all(self._sock, [*answer, ack])

    def _take_text(self) -> bool:
        while (line := self._stream.line(command.LONGEST_TEXT)) is not None:
            if not line:
                continue
            word = command.parse_line(line)
            answer = b""
            if word.key in ("d", "D", "a"):
                content = self._stream.line()
                if content is None:
                    return False
                answer = self._take_line(word, content)
            elif word.key not in ("q", "r"):
                answer = self._lines(self.port.obey(word, self))
            if self.carrier.ack:
                answer += _TEXT_ACK
            if answer:
                self._sock.sendall(answer)
            if word.key in ("q", "r"):
                return word.key == "r"
        return False

    def _take_line(self, word: command.PortCommand, content: bytes) -> bytes:
        payload = self.port.from_line(content)
        if word.key == "a":
            return self.port.to_line(self.port.administer(payload, self))
        quiet = word.key == "D" or word.text == "do" or not self.carrier.reply
        message = Message(payload, word.envelope if word.text != "do" else "", self, not quiet)
        self.counters.received += 1
        if quiet:
            self.port.deliver(message)
            return b""
        return self.port.to_line(self._deliver(message))

    @staticmethod
    def _lines(lines: tuple[str, ...]) -> bytes:
        return "".join(f"{line}\r\n" for line in lines).encode()


__all__ = ["EMPTY", "Buffer", "Input", "carriers"]
