"""Text inputs: the carriers text and text_ack, the name server's carrier, and browsers.

A browser gets a page about the port, sends a message from a form, or reads a stream of the port's messages.
"""

from __future__ import annotations

from typing import Any

from yarp_compat.overriding import override
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.outgoing import from_line, to_line
from yarp_compat.wire import framing, http
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import PortCommand
from yarp_compat.wire.http import PageRequest
from yarp_compat.wire.text import from_text, to_text

_ACK = b"<ACK>\r\n"
LONGEST_REQUEST = 64 << 10  # bytes of the longest line to a name server


class TextInput(Input):
    """An input over text or text_ack: command lines; for data and administration, a line with a Bottle follows."""

    @override
    def handle_messages(self) -> bool:
        ack = _ACK if self.carrier.ack else b""
        while (line := self.stream.line(framing.LONGEST_TEXT)) is not None:
            if not line:
                continue
            command = framing.parse_command_line(line)
            answer, last = b"", False
            if command.key in ("d", "D", "a"):
                content = self.stream.line()
                if content is None:
                    return False
                answer, last = self._content(command, from_line(content, self.port.profile))
            elif command.key not in ("q", "r"):
                answer = "".join(f"{line}\r\n" for line in self.port.execute(command)).encode()
            if answer or ack:
                self.sock.sendall(answer + ack)
            self.reply_sent()
            if last or command.key in ("q", "r"):
                return command.key == "r"
        return False

    def _content(self, command: PortCommand, payload: bytes) -> tuple[bytes, bool]:
        """Return the answer to a command with a Bottle, and whether the connection has to end."""
        if command.key == "a":
            answer = to_line(self.port.administer(payload, self), self.profile)
            return (answer if self.carrier.reply else b""), False
        data_only = command.text == "do"
        quiet = command.key == "D" or data_only or not self.carrier.reply
        message = PortMessage(payload, "" if data_only else command.envelope, self, not quiet)
        self.counters.received += 1
        if quiet:
            self.port.deliver(message)
            return b"", message.is_last
        return to_line(self.deliver(message), plain=message.is_plain), message.is_last


class NameInput(Input):
    """An input over name_ser: lines that begin with ``NAME_SERVER``. Without ``on_line`` they are ordinary messages.

    The name server's lines are answered on the shared thread, since a program sends about eight for each of its ports,
    each over a new connection. A thread continues if that would block: after an incomplete line, a command that
    takes time, and an answer for which the socket has no room.
    """

    _unanswered: bytes | None = None
    _unsent = b""

    @override
    def start(self, loop: PortLoop) -> None:
        if self.port.on_line is not None and self._has_bytes and loop.is_own_thread:
            self._serve(loop)
        else:
            super().start(loop)

    def _serve(self, loop: PortLoop, *, receive: bool = False) -> None:
        """Answer the received lines, first with the bytes that have just arrived if ``receive``; then wait for more."""
        try:
            connected = not receive or self.stream.receive()
            while connected and self._answer_line():
                pass
        except Exception as error:
            self._report(error)
            connected = False
        if not connected:
            self._end()
        elif self._unsent or self._unanswered or self.stream.left():
            self._begin()
        else:
            self._await(loop)

    def _answer_line(self) -> bool:
        """Answer a received line; return False without one, or if it remains for the thread."""
        line = self.stream.received_line(LONGEST_REQUEST)
        if line is None:
            return False
        if line:
            self.counters.received += 1
            answer = self._answer(line, wait=False)
            if answer is None:
                self._unanswered = line
            else:
                self._unsent = answer[self._send_now(answer) :]
        return not (self._unanswered or self._unsent)

    def _send_now(self, answer: bytes) -> int:
        """Send as much as the socket has room for; return the number of bytes."""
        self.sock.setblocking(False)
        try:
            return self.sock.send(answer)
        except BlockingIOError:
            return 0
        finally:
            self.sock.setblocking(True)

    @override
    def _on_bytes(self, loop: PortLoop) -> None:
        if self.port.on_line is None:
            super()._on_bytes(loop)
        else:
            self._serve(loop, receive=True)

    @override
    def handle_messages(self) -> bool:
        self.sock.sendall(self._unsent)
        if self._unanswered is not None:
            self.sock.sendall(self._answer(self._unanswered, wait=True) or b"")
        while (line := self.stream.line(LONGEST_REQUEST)) is not None:
            if line:
                self.counters.received += 1
                self.sock.sendall(self._answer(line, wait=True) or b"")
                self.reply_sent()
        return False

    def _answer(self, line: bytes, *, wait: bool) -> bytes | None:
        if self.port.on_line is not None:
            text = line.decode(errors="surrogateescape").removeprefix("NAME_SERVER").strip()
            return self.port.on_line(text, self.address, wait=wait)
        message = PortMessage(from_line(line, self.port.profile), "", self, wants_reply=True)
        return to_line(self.deliver(message), plain=message.is_plain)


class PageInput(Input):
    """An input over http: one request."""

    @override
    def handle_messages(self) -> bool:
        """Answer the request; return True if it asks for a stream of the port's messages."""
        head = b""
        while True:
            line = self.stream.line(http.LONGEST_HEAD)
            if line is None:
                return False
            if not line and head:
                break
            head += line + b"\n"
            if len(head) > http.LONGEST_HEAD:
                self.sock.sendall(http.response(b"too long\n", "text/plain", "431 Request Header Fields Too Large"))
                return False
        try:
            request = http.parse(head)
            if request.length:
                request = request.with_form(self.stream.exactly(request.length) or b"")
            if request.path in ("r", "read"):
                self.sock.sendall(http.STREAM_HEAD)
                return True
            answer = self._answer(request)
        except WireError as error:
            answer = http.response(f"{error}\n".encode(), "text/plain; charset=utf-8", "400 Bad Request")
        self.sock.sendall(answer)
        return False

    def _answer(self, request: PageRequest) -> bytes:
        query = request.query
        outer = query.get("outer", "auto")
        if request.path == "favicon.ico":
            return http.response(b"", "image/x-icon", "404 Not Found")
        if request.foreign and (query or request.path):
            msg = "requests from pages of other sites are refused"
            return http.response(msg.encode() + b"\n", "text/plain", "403 Forbidden")
        if "admin" in query:
            command = query["admin"] or query.get("data", "")
            answer = decode(self.port.administer(encode(from_text(command), self.port.profile), self))
            return self._page([to_text(answer)])
        if "req" in query:
            fields = {"format": "json", **query, "REQUEST_URI": request.target}
            values = [*from_text(query["req"]), *([key, fields[key]] for key in sorted(fields))]
            return self._message(values, outer)
        if "data" in query:
            return self._message(from_text(query["data"]), outer if query.get("format") == "json" else "")
        if not request.path:
            return self._page(self.port.execute(PortCommand("*")))
        return self._message([*from_text(request.path.replace("/", " ")), *([[k, v] for k, v in query.items()])])

    def _message(self, values: list[Any], json: str = "") -> bytes:
        """Pass a message to the port's owner and return the reply: a page, or JSON (``dict``, ``list``, ``auto``)."""
        message = PortMessage(encode(values, self.port.profile), "", self, wants_reply=True)
        self.counters.received += 1
        reply = self.deliver(message)
        data = reply if isinstance(reply, (bytes, bytearray, memoryview)) else b"".join(reply)
        if message.is_plain:
            return self._page(bytes(data).decode(errors="replace").split("\r\n"))
        content = decode(data)
        if json:
            return http.response(http.as_json(content, json), "text/json")
        if content[:1] == ["web"] and len(content) > 1:  # a page made by the port's owner
            kind = content[3] if content[2:3] == ["mime"] and len(content) > 3 else "text/html"
            return http.response(str(content[1]).encode(errors="replace"), str(kind))
        return self._page([str(v) for v in content[1:]] if content[:1] == ["many"] else [to_text(content)])

    def _page(self, lines: tuple[str, ...] | list[str]) -> bytes:
        names = getattr(self.port.naming, "contact", None)
        return http.response(http.page(self.port.name, lines, names if isinstance(names, PortContact) else None))
