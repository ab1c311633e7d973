"""Recorded bytes of real YARP programs, replayed to and compared with Midspan's ports: both roles, both dialects."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest

from tests.support.wait import until
from tests.yarp_compat.transcripts import Talk, read
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore
from yarp_compat.wire import framing
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.carriers import frame, framed
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text

Steps = list[tuple[int, str, bytes]]
PROFILES = list(Profile)


def in_profile(data: bytes, profile: Profile) -> bytes:
    """Convert a recorded message of 4.0 to a dialect."""
    if not data.startswith(framing.INDEX):
        return data
    command, payload = framing.parse(data)
    if command.key not in "dD":
        return data
    return framing.prefix(len(content := encode(decode(payload, Profile.YARP4), profile)), command.key) + content


def split(data: bytes) -> list[bytes]:
    """Split messages that were recorded in one piece."""
    if data.startswith(framing.INDEX):
        size = framing.index_size(data)
        size += framing.body_size(data)
        return [data[:size], *(split(data[size:]) if data[size:] else [])]
    if data.startswith((b"D\r\n", b"d\r\n")):
        lines = data.split(b"\r\n")
        return [b"\r\n".join(lines[i : i + 2]) + b"\r\n" for i in range(0, len(lines) - 1, 2)]
    return [data]


@contextlib.contextmanager
def opened(name: str, number: int, **options: object) -> Iterator[tuple[PortCore, tuple[str, int]]]:
    """Open a port that announces the recorded number; yield it and its real address."""
    port = PortCore(name, naming=LocalNaming(), **options)  # type: ignore[arg-type]
    at = port.open()
    port.contact = PortContact(name, "127.0.0.1", number)
    try:
        yield port, (at.host, at.port)
    finally:
        port.close()


def receive(sock: socket.socket, size: int) -> bytes:
    """Receive ``size`` bytes."""
    sock.settimeout(10)
    received = b""
    while len(received) < size and (part := sock.recv(size - len(received))):
        received += part
    return received


def talks(name: str, *numbers: int, without: range = range(0)) -> list[Talk]:
    """Return the recorded connections to some ports."""
    return [talk for talk in read(name, joined=False) if talk.port in numbers and talk.number not in without]


MCAST = range(15, 24)
"""The mcast connections of carriers-admin.txt, which these tests do not cover."""


# -- Midspan's port accepts --------------------------------------------------------------------------------------------


def assert_answers(talk: Talk, address: tuple[str, int], profile: Profile) -> None:
    """Send the initiator's bytes and compare the answers."""
    with socket.create_connection(address) as sock:
        for step in talk.steps:
            if step.by == "C":
                sock.sendall(in_profile(step.data, profile))
            elif step.by == "S":
                received = receive(sock, len(step.data))
                if step.data.startswith(b"YA") and talk.steps[0].data.startswith(b"YAa"):
                    assert framed(received), "a reply for udp contains a different port number"
                elif step.data != b"\0\0\0\0":
                    assert received == step.data


@pytest.mark.parametrize("profile", PROFILES)
def test_a_reader_answers_yarp_connect_as_recorded(profile: Profile) -> None:
    got: list[list[object]] = []

    def on_message(incoming: PortMessage) -> None:
        got.append(decode(incoming.payload, profile))

    with opened("/reader", 10002, on_message=on_message) as (_, address):
        for talk in talks("connect.txt", 10002):
            assert_answers(talk, address, profile)
        until(lambda: len(got) == 3, "three messages have arrived")
    assert got == [["hello", 42, 3.5], [1, 2, 3], [["a", "b"], "ok", b"\1\2\xff", "x y", -7, 3000000000]]


@pytest.mark.parametrize("profile", PROFILES)
def test_an_rpc_server_replies_with_the_recorded_bytes(profile: Profile) -> None:
    def pong(incoming: PortMessage) -> None:
        assert decode(incoming.payload, profile) == ["ping", "hi there", 1.5]
        incoming.reply(encode(["pong", 1, [2, 3]], profile))

    with opened("/server", 10004, on_message=pong, rpc=True) as (port, address):
        (talk,) = talks("rpc.txt", 10004)
        assert_answers(talk, address, profile)
        assert port.counters.dropped.total() == 0


def _comparable(talk: Talk) -> Talk:
    """Leave out the request for properties of the process, and its reply (only in connection 39)."""
    if talk.number != 39:
        return talk
    kept = []
    for request, answer in zip(talk.steps[::2], talk.steps[1::2], strict=True):
        if b"prop\x09\0\0\0get\0\x04" in request.data:
            continue  # the reply describes the recorded process; tested in test_admin
        kept += [request, answer]
    return Talk(talk.number, talk.port, kept)


@pytest.mark.parametrize("number", [t.number for t in talks("carriers-admin.txt", 10005, without=MCAST)])
def test_a_reader_answers_each_carrier_as_recorded(number: int) -> None:
    got: list[str] = []
    with opened("/r", 10005, on_message=lambda m: got.append(str(decode(m.payload)))) as (port, address):
        (talk,) = [t for t in talks("carriers-admin.txt", 10005) if t.number == number]
        if b"~/w" in talk.sent_by("C"):
            sock = socket.create_connection(address)
            sock.sendall(b"YAd\x1e\0\0RP\x03\0\0\0/w\0")
            until(port.inputs, "the connection to be removed exists")
            assert_answers(talk, address, Profile.YARP4)
            assert sock.recv(100)[:2] == b"YA"
            assert sock.recv(100) == b"", "the port has closed the connection"
            sock.close()
            return
        if number == 39:
            help_at = next(i for i, s in enumerate(talk.steps) if b"help" in s.data and s.by == "C")
            _check_help(talk.steps[help_at].data, talk.steps[help_at + 1].data, address)
            del talk.steps[help_at : help_at + 2]
            until(lambda: not port.inputs(), "the end of that connection is detected")
        assert_answers(_comparable(talk), address, Profile.YARP4)
        count = sum(len(split(s.data)) for s in talk.steps if s.by == "C" and s.data[:1] in b"DY" and b"msg" in s.data)
        until(lambda: len(got) == count, f"{count} messages have arrived")
        assert all("msg" in g for g in got)


def _check_help(request: bytes, answer: bytes, address: tuple[str, int]) -> None:
    """Compare the start of the reply with the 512 bytes that were recorded."""
    with socket.create_connection(address) as sock:
        sock.sendall(b"YA\xe4\x1e\0\0RP\x09\0\0\0anon_rpc\0" + request)
        assert receive(sock, 8 + 1494)[8:][: len(answer)] == answer
        assert len(answer) == 0x200


def test_writer_answers_companions() -> None:
    """This port receives only queries about its connections."""
    with opened("/w", 10006) as (_, address):
        for number in (1, 7, 24):
            (talk,) = [t for t in talks("carriers-admin.txt", 10006) if t.number == number]
            assert_answers(talk, address, Profile.YARP4)


# -- Midspan's port connects -------------------------------------------------------------------------------------------


@pytest.fixture
def _without_queries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable the query of the dialect, which the recorded programs do not send; test_dialect covers it."""
    monkeypatch.setattr("yarp_compat.ports.base.ask_profile", lambda _contact: None)


class Stage:
    """All peers of the tested port, in the recorded order: the companion, and the port that the tested one calls."""

    def __init__(self, port: PortCore, address: tuple[str, int], number: int, peer: int, profile: Profile) -> None:
        self.port = port
        self.address = address
        self.number = number
        self.peer = peer
        self.profile = profile
        self.server = socket.create_server(("127.0.0.1", 0))
        self.server.settimeout(10)
        self.datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.datagrams.bind(("127.0.0.1", 0))
        self.socks: dict[int, socket.socket] = {}

    def close(self) -> None:
        for sock in (self.server, self.datagrams, *self.socks.values()):
            sock.close()

    def expect(self, recorded: list[Talk]) -> None:
        """Replay the peers' bytes, and compare the tested port's bytes with the recording."""
        by_time = sorted(
            ((step.time, talk.number, step, talk) for talk in recorded for step in talk.steps),
            key=lambda s: (s[0], s[1]),
        )
        for _, _, step, talk in by_time:
            calls_us = talk.port == self.number
            if calls_us and talk.number not in self.socks:
                self.socks[talk.number] = socket.create_connection(self.address)
            if step.by == ("C" if calls_us else "S"):
                self._send(talk, step.data)
            else:
                self._expect(talk, step.data)

    def _send(self, talk: Talk, data: bytes) -> None:
        if talk.steps[0].data.startswith(b"YAa") and data.startswith(b"YA"):
            data = frame(self.datagrams.getsockname()[1])
        self.socks[talk.number].sendall(data)

    def _expect(self, talk: Talk, data: bytes) -> None:
        if talk.number not in self.socks:
            self.socks[talk.number] = self.server.accept()[0]
        for part in split(data):
            self._provoke(part)
            expected = in_profile(part, self.profile)
            assert receive(self.socks[talk.number], len(expected)) == expected

    def _provoke(self, expected: bytes) -> None:
        """Make the tested port write the message that is expected next."""
        if expected.startswith((b"D\r\n", b"d\r\n")):
            self.port.write(encode(from_text(expected.split(b"\r\n")[1].decode()), self.profile), strict=True)
        elif expected.startswith(framing.INDEX):
            command, payload = framing.parse(expected)
            if command.key in "dD":
                self.port.write(encode(decode(payload, Profile.YARP4), self.profile), strict=True)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(
    ("name", "number", "other", "file"),
    [("/writer", 10003, ("/reader", 10002), "connect.txt"), ("/w", 10006, ("/r", 10005), "carriers-admin.txt")],
)
@pytest.mark.usefixtures("_without_queries")
def test_a_writer_sends_the_recorded_bytes(
    name: str, number: int, other: tuple[str, int], file: str, profile: Profile
) -> None:
    """A companion connects the writer to another port, the writer writes, and the companion disconnects it."""
    left_out = MCAST if number == 10006 else range(0)
    recorded = [t for t in talks(file, number, other[1], without=left_out) if t.steps]
    with opened(name, number, profile=profile) as (port, address):
        stage = Stage(port, address, number, other[1], profile)
        port.naming.register(other[0], *stage.server.getsockname())
        try:
            if number == 10003:
                stage.expect([_without_quit(t) for t in recorded])  # this writer ended with its process
            else:
                stage.expect([t for t in recorded if t.number < 36])
        finally:
            stage.close()


def _without_quit(talk: Talk) -> Talk:
    at = next((i for i, s in enumerate(talk.steps) if s.data == framing.QUIT), len(talk.steps))
    return Talk(talk.number, talk.port, talk.steps[:at])


@pytest.mark.usefixtures("_without_queries")
@pytest.mark.parametrize("profile", PROFILES)
def test_an_rpc_client_sends_the_recorded_bytes(profile: Profile) -> None:
    (talk,) = talks("rpc.txt", 10004)
    hello, answer, request, reply, farewell, acknowledged = [s.data for s in talk.steps]
    with (
        opened("/client", 10010, profile=profile, rpc=True) as (port, _),
        socket.create_server(("127.0.0.1", 0)) as server,
    ):
        port.naming.register("/server", *server.getsockname())
        port.name = "anon_rpc"
        received: list[bytes] = []

        def serve() -> None:
            sock, _ = server.accept()
            with sock:
                received.append(receive(sock, len(hello)))
                sock.sendall(answer)
                received.append(receive(sock, len(in_profile(request, profile))))
                sock.sendall(reply)
                received.append(receive(sock, len(farewell)))
                sock.sendall(acknowledged)

        thread = threading.Thread(target=serve)
        thread.start()
        assert port.add_output("/server")[0]
        reply = port.request(encode(["ping", "hi there", 1.5], profile), timeout=10)
        assert decode(reply, profile) == ["pong", 1, [2, 3]]
        port.remove_output("/server")
        thread.join(10)
        port.name = "/client"
    assert received == [hello, in_profile(request, profile), farewell]
