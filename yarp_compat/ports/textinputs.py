"""Inputs that speak lines of text: text, text_ack, and the name server's own."""

from __future__ import annotations

from yarp_compat.ports.inputs import Input
from yarp_compat.ports.lines import from_line, to_line
from yarp_compat.ports.message import Message
from yarp_compat.wire import command
from yarp_compat.wire.command import PortCommand

_ACK = b"<ACK>\r\n"
LONGEST_REQUEST = 64 << 10
"""Bytes of the longest line to a name server."""


class TextInput(Input):
    """An input of text or text_ack: a line with a command, and for data and administration a line with a Bottle."""

    def take(self) -> bool:
        """Take messages until the end; True where the connection is to be turned round."""
        ack = _ACK if self.carrier.ack else b""
        while (line := self.stream.line(command.LONGEST_TEXT)) is not None:
            if not line:
                continue
            word = command.parse_line(line)
            answer, last = b"", False
            if word.key in ("d", "D", "a"):
                content = self.stream.line()
                if content is None:
                    return False
                answer, last = self._content(word, from_line(content, self.port.profile))
            elif word.key not in ("q", "r"):
                answer = "".join(f"{line}\r\n" for line in self.port.obey(word)).encode()
            if answer or ack:
                self.sock.sendall(answer + ack)
            self.answered()
            if last or word.key in ("q", "r"):
                return word.key == "r"
        return False

    def _content(self, word: PortCommand, payload: bytes) -> tuple[bytes, bool]:
        """What is answered to a command with a Bottle; and whether the connection is to end."""
        if word.key == "a":
            answer = to_line(self.port.administer(payload, self), self.profile)
            return (answer if self.carrier.reply else b""), False
        data_only = word.text == "do"
        quiet = word.key == "D" or data_only or not self.carrier.reply
        message = Message(payload, "" if data_only else word.envelope, self, not quiet)
        self.counters.received += 1
        if quiet:
            self.port.deliver(message)
            return b"", message.is_last
        return to_line(self.deliver(message), plain=message.is_plain), message.is_last


class NameInput(Input):
    """An input of name_ser.

    Lines that begin with ``NAME_SERVER``. Without a hook for them, they are messages like others.
    """

    def take(self) -> bool:
        """Answer lines until the end."""
        while (line := self.stream.line(LONGEST_REQUEST)) is not None:
            if not line:
                continue
            self.counters.received += 1
            text = line.decode(errors="surrogateescape").removeprefix("NAME_SERVER").strip()
            self.sock.sendall(self._answer(text, line))
            self.answered()
        return False

    def _answer(self, text: str, line: bytes) -> bytes:
        if self.port.on_line is not None:
            return self.port.on_line(text, self.address)
        message = Message(from_line(line, self.port.profile), "", self, wants_reply=True)
        return to_line(self.deliver(message), plain=message.is_plain)
