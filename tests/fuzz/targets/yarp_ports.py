"""YARP's connections: introductions, messages, datagrams, lines, pages, administration."""

from __future__ import annotations

import socket
from typing import Any, cast

from tests.fuzz.target import Subject, Target, texts
from yarp_compat.ports import admin
from yarp_compat.ports.admin import execute
from yarp_compat.ports.inputs import BinaryInput, Input
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.outgoing import to_line
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.textinputs import NameInput, PageInput, TextInput
from yarp_compat.wire import carriers, framing, http
from yarp_compat.wire.binary import encode
from yarp_compat.wire.carriers import Opening
from yarp_compat.wire.datagrams import Assembler, split
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import PortCommand
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text

_BOTTLE = encode(["hello", 42, 3.5, [1, 2], b"x"], Profile.YARP3)
_DATA = framing.prefix(len(_BOTTLE)) + _BOTTLE
_REQUEST = framing.prefix(len(_BOTTLE), "d", "7 1.5") + _BOTTLE
_ADMIN = framing.prefix(len(_BOTTLE), "a") + _BOTTLE
_WORDS = [b"YA", b"RP", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\0\0\0\0", b"~D\0\1", b"~\0\0\1",
          framing.INDEX, framing.ACK, framing.QUIT, b"\2\1" + b"\xff" * 8]  # fmt: skip
_LIMIT = 1 << 20


class _FakeConnection(socket.socket):
    """A connection on which a peer sends some bytes and then closes; it counts the bytes sent to the peer."""

    def __init__(self, data: bytes) -> None:
        super().__init__()
        self._left = memoryview(data)
        self.answered = 0

    def recv_into(self, buffer: Any, *_: Any) -> int:  # type: ignore[override]
        part = self._left[: min(len(buffer), 1000)]
        buffer[: len(part)] = part
        self._left = self._left[len(part) :]
        return len(part)

    def sendall(self, data: Any, *_: Any) -> None:
        self.answered += len(data)

    def send(self, data: Any, *_: Any) -> int:
        self.answered += len(data)
        return len(data)

    def setblocking(self, flag: bool) -> None:
        del flag


def _echo(incoming: PortMessage) -> None:
    incoming.reply(incoming.payload)


def _port() -> PortCore:
    """Return a port that accepts messages, but neither listens nor connects."""
    port = PortCore("/fuzzed", on_message=_echo, naming=LocalNaming(), limit=_LIMIT, is_output=False)
    port._loop = cast(PortLoop, object())
    return port


def _conversation(kind: type[Input], carrier: carriers.Carrier, seeds: list[bytes], tokens: list[bytes]) -> Subject:
    """All input on one connection of a carrier."""
    port = _port()

    def parse(data: bytes) -> None:
        with _FakeConnection(data) as sock:
            kind(port, sock, Opening(carrier, "/peer", "", 0), b"", ("127.0.0.1", 1)).handle_messages()
        assert len(port.properties) <= admin.MOST_PROPERTIES

    return Subject(parse, seeds, (WireError,), tokens)


def _opening() -> Subject:
    """An introduction; a parsed one keeps its carrier and sender if written again, and needs its last byte."""
    seeds = [carriers.opening(c, "/w", q) for c in carriers.OUTPUTS for q in ("", "recv.portmonitor+type.dll")]
    seeds += texts("NAME_SERVER query /x\r\n", "GET / HTTP/1.1\r\n\r\n", "POST /form HTTP/1.1\r\n\r\n")

    def parse(data: bytes) -> None:
        opened = carriers.parse_opening(data)
        if opened is None or not opened.size:
            return
        carriers.answer(opened, 10002)
        assert opened.size <= len(data)
        again = carriers.parse_opening(carriers.opening(opened.carrier, opened.sender))
        assert again is not None
        assert (again.carrier, again.sender) == (opened.carrier, opened.sender)
        assert carriers.parse_opening(data[: opened.size - 1]) is None

    return Subject(parse, seeds, (WireError,), [*_WORDS, b"CONNECT ", b"CONNACK ", b"\r\n", b" ("], 4096)


def _message() -> Subject:
    """One whole message."""

    def parse(data: bytes) -> None:
        head, payload = framing.parse(data, _LIMIT)
        assert len(payload) <= len(data)
        assert len(head.key) <= 1

    return Subject(parse, [_DATA, _REQUEST, _ADMIN, framing.QUIT, framing.words("/reader")], (WireError,), _WORDS)


def _binary() -> Subject:
    seeds = [_DATA, _REQUEST + _DATA, _ADMIN + framing.QUIT, framing.words("*") + _DATA]
    seeds += [framing.words("!/x"), framing.words("~/x"), framing.words("/x")]
    return _conversation(BinaryInput, carriers.TCP, seeds, _WORDS)


def _datagrams() -> Subject:
    """Datagrams, each after a length byte; a checksum of 0 is corrected, to reach the code after the check."""
    import struct
    import zlib

    def parse(data: bytes) -> None:
        assembler = Assembler(_LIMIT)
        while data:
            piece, data = data[1 : 1 + data[0]], data[1 + data[0] :]
            if piece[:4] == bytes(4):
                piece = struct.pack("<I", zlib.crc32(piece[8:])) + piece[4:]
            try:
                message = assembler.add(piece)
            except WireError:
                continue
            if message is not None:
                framing.parse(message, _LIMIT)

    pieces = [bytes(4) + struct.pack("<i", i) + _DATA[i * 30 : i * 30 + 30] for i in range(4)]
    whole = b"".join(bytes([len(p)]) + p for p in pieces)
    datagrams = b"".join(bytes([len(p)]) + p for p in split([_DATA]))
    return Subject(parse, [whole, datagrams, whole + datagrams], (WireError,), _WORDS)


_LINES = [b"d\r\n", b"D\r\n", b"do\r\n", b"a\r\n", b"q\r\n", b"*\r\n", b"?\r\n", b"D 1 2.5\r\n",
          b"/x\r\n", b"!/x\r\n", b"~/x\r\n",
          b"[list] [in]\r\n", b"[prop] [set] a b\r\n", b"(" * 200, b'"', b"\\", b"\0", b"\xff", b"1e999 "]  # fmt: skip


def _text() -> Subject:
    seeds = [
        b"d\r\nhello 42 (1 2)\r\nq\r\n",
        b"D 1 2.5\r\nx\r\na\r\n[ver]\r\n",
        b"*\r\n?\r\n",
        b"a\n[prop] [get] /fuzzed\n",
    ]
    return _conversation(TextInput, carriers.TEXT_ACK, seeds, _LINES)


def _names() -> Subject:
    seeds = texts("NAME_SERVER query /x\r\nNAME_SERVER list\n", "NAME_SERVER register /x tcp 1.2.3.4 5\r\n")
    return _conversation(NameInput, carriers.NAME_SER, seeds, [*_LINES, b"NAME_SERVER ", b"bot "])


_PAGES = texts(
    "GET / HTTP/1.1\r\nHost: a\r\n\r\n", "GET /?data=hello+1&format=json HTTP/1.1\r\n\r\n",
    "GET /a/b?c=d HTTP/1.0\r\n\r\n",
    "POST /form HTTP/1.1\r\nContent-Length: 12\r\nOrigin: http://b\r\n\r\ndata=(a 1) 2",
    "GET /?admin=[ver] HTTP/1.1\n\n",
    "GET /?req=list&outer=dict HTTP/1.1\r\n\r\n",
)  # fmt: skip
_PAGE_WORDS = texts(
    "GET ", "POST ", " HTTP/1.1", "\r\n\r\n", "?", "&", "=", "%", "%00", "%ff", "+", "data=", "req=", "admin=",
    "format=json",
    "outer=list", "outer=dict", "list", "dict", "web", "many", "Content-Length: ", "Origin: ", "99999999", "-1",
    "[", "//[",
    "\u0663",
)  # fmt: skip


def _pages() -> Subject:
    return _conversation(PageInput, carriers.HTTP, _PAGES, [*_PAGE_WORDS, b"(" * 200, b"\xff"])


def _json() -> Subject:
    """A Bottle as JSON and its lines as a page; both always succeed, and return text."""
    import json

    def parse(data: bytes) -> None:
        values = from_text(data.decode(errors="replace"))
        for outer in ("auto", "list", "dict"):
            json.loads(http.as_json(values, outer))
        page = http.page("/p", [to_line(encode(values, Profile.YARP3)).decode(errors="replace")])
        assert b"<script" not in page

    seeds = texts("ports (port (name /a) (port_number 1)) (b 2)", "dict (a 1) (b (list 1 2))", "{1 2} 1.5 inf nan [ok]")
    tokens = texts("list", "dict", "(", ")", "<script", "registration name /a ip 1 port 2 type tcp", "inf", '"', "true")
    return Subject(parse, seeds, (WireError,), tokens)


def _admin() -> Subject:
    """Administrative and one-letter commands; each has a reply that can be encoded."""
    port = _port()

    def parse(data: bytes) -> None:
        text = data.decode(errors="replace")
        reply = admin.answer(port, from_text(text))
        assert reply == [] or encode(reply, Profile.YARP4)
        assert len(port.properties) <= admin.MOST_PROPERTIES
        assert execute(port, PortCommand(text[:1], text))

    seeds = texts(
        "[help]", "[ver]", '[add] "tcp://r"', "[add] /r udp", "[del] /r", "[list] [in]", "[list] [out] /r",
        "[prop] [get]",
        "[prop] [set] k (1 2)", "[prop] [get] /fuzzed", "[set] [out] /r (a 1)", "[get] [in] /r", "[atch] [out] x",
        "[dtch] [in]",
    )  # fmt: skip
    tokens = texts(
        "[in]", "[out]", "/r", "://", "mcast", "+", "[get]", "[set]", "/1.2.3.4:5/", ":99999999/", "()", "{1}"
    )
    return Subject(parse, seeds, (WireError,), tokens, largest=1024)


TARGETS = (
    Target("yarp_opening", 20_000, _opening),
    Target("yarp_message", 20_000, _message),
    Target("yarp_binary", 20_000, _binary),
    Target("yarp_datagrams", 20_000, _datagrams),
    Target("yarp_text", 15_000, _text),
    Target("yarp_name_connection", 5_000, _names),
    Target("yarp_pages", 10_000, _pages),
    Target("yarp_json", 10_000, _json),
    Target("yarp_admin", 10_000, _admin),
)
