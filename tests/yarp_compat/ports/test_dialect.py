"""Ports query the YARP dialect of others: recorded answers of 3.12.3 and 4.0, and invalid answers."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest

from tests.support.wait import until
from tests.yarp_compat.dev.test_service import Places, PlacesServer
from tests.yarp_compat.ports.conftest import MakePort
from yarp_compat.dev.client import PortChannel
from yarp_compat.dev.server import Server
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.text_client import ask_profile
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile

YARP_3_12 = b'Welcome admin\r\n1 "" 20698\r\n<ACK>\r\n'
YARP_4 = b'Welcome admin\r\n[fail] "send [help] for list of valid commands"\r\n<ACK>\r\n'
DIALECTS = {YARP_3_12: Profile.YARP3, YARP_4: Profile.YARP4}


class Other:
    """A port of another program that, like C++ ports, answers queries except while it waits for a reply."""

    def __init__(self, answer: bytes) -> None:
        self.answer = answer
        self.asked: list[bytes] = []
        self.waits = threading.Event()
        self.data: list[socket.socket] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    @property
    def address(self) -> tuple[str, int]:
        host, number = self._server.getsockname()
        return host, number

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._thread.join(10)
        for sock in self.data:
            sock.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                sock = self._server.accept()[0]
                first = sock.recv(100)
                if not first.startswith(b"CONNACK"):
                    sock.sendall(b"YA\x12\x27\0\0RP")
                    self.data.append(sock)
                    continue
                with sock:
                    while first.count(b"\n") < 3:
                        first += sock.recv(100)
                    self.asked.append(first)
                    if not self.waits.is_set():
                        sock.sendall(self.answer)


@pytest.fixture(params=DIALECTS)
def other(request: pytest.FixtureRequest) -> Iterator[Other]:
    """A port of either dialect."""
    port = Other(request.param)
    yield port
    port.close()


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ports wait for the answers of others that stand still."""
    monkeypatch.setattr("yarp_compat.ports.base.ask_profile", lambda contact: ask_profile(contact, timeout=40.0))


def test_recorded_answers_are_recognized(other: Other) -> None:
    assert ask_profile(PortContact("/other", *other.address, "tcp"), timeout=40.0) is DIALECTS[other.answer]
    assert other.asked == [b"CONNACK admin\r\na\r\ngetPid\r\n"]


@pytest.mark.parametrize(
    "answer",
    [b"", b"HTTP/1.0 400\r\n\r\n", b"Welcome admin\r\n<ACK>\r\n", b"Welcome admin\r\n(((\r\n<ACK>\r\n",
     b"Welcome admin\r\n2 7\r\n<ACK>\r\n", b"Welcome admin\r\n" + b"x" * 100_000],
)  # fmt: skip
def test_invalid_answers_have_no_dialect(answer: bytes) -> None:
    port = Other(answer)
    try:
        odd = PortContact("/odd", *port.address, "tcp")
        assert ask_profile(odd) is None
    finally:
        port.close()
    assert ask_profile(odd) is None, "the port no longer listens"


def test_query_of_a_silent_port_times_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert ask_profile(PortContact("/mute", "127.0.0.1", server.getsockname()[1]), timeout=0.1) is None


@pytest.mark.parametrize("profile", Profile)
def test_midspans_ports_answer_their_dialect(make_port: MakePort, profile: Profile) -> None:
    assert ask_profile(make_port("/p", profile=profile).contact, timeout=40.0) is profile


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("carrier", ["tcp", "fast_tcp"])
def test_output_writes_in_its_readers_dialect(
    make_port: MakePort, naming: LocalNaming, other: Other, carrier: str
) -> None:
    profile = DIALECTS[other.answer]
    naming.register("/other", *other.address)
    writer = make_port("/w", profile=Profile.YARP4 if profile is Profile.YARP3 else Profile.YARP3)
    assert writer.add_output(f"{carrier}://other")[0]
    (output,) = writer.connections.outputs
    assert output.profile is profile
    writer.write(lambda dialect: encode([1.5], dialect), strict=True)
    expected = encode([1.5], profile)
    received = b""
    other.data[0].settimeout(10)
    while not received.endswith(expected):
        received += other.data[0].recv(1000)


def call(port: PortContact, name: bytes) -> socket.socket:
    """Return a client's fast_tcp connection, which the server has not answered yet."""
    sock = socket.create_connection((port.host, port.port), 10)
    sock.sendall(b"YAd\x1e\0\0RP" + (len(name) + 1).to_bytes(4, "little") + name + b"\0")
    return sock


def ask(sock: socket.socket, request: bytes, size: int) -> bytes:
    """Send a request and receive ``size`` bytes of the reply."""
    index = b"YA\x0a\0\0\0RP\x02\x01" + b"\xff" * 8 + (8).to_bytes(4, "little") + len(request).to_bytes(4, "little")
    sock.sendall(index + bytes(4) + b"\0\0\0\0~d\0\1" + request)
    received = b""
    while len(received) < size and (part := sock.recv(size - len(received))):
        received += part
    return received


@pytest.mark.usefixtures("patient")
def test_release_is_decided_before_the_client_asks_for_the_version(
    make_port: MakePort, naming: LocalNaming, other: Other
) -> None:
    """A client's port answers no queries while it waits for a reply, so it is queried before the first request."""
    naming.register("/client", *other.address)
    server = Server(PlacesServer())
    port = make_port("/server", server, rpc=True, on_event=server.on_event)
    with call(port.contact, b"/client") as sock:
        assert len(sock.recv(8)) == 8
        other.waits.set()
        version = ask(sock, encode(["getRemoteProtocolVersion"], Profile.YARP3), 16)
        cleared = ask(sock, Places.calls()["clear_RPC"].request([], Profile.YARP3), 8)
        if DIALECTS[other.answer] is Profile.YARP4:
            assert version.hex() == "00010000010000000300040000000000"
            assert cleared + sock.recv(8) == bytes.fromhex("00010000 01000000 09000000 6f6b0000")
        else:
            assert version.hex() == "0001000001000000030003000c000000"
            assert cleared == bytes.fromhex("01000000 00000000")
        (decision,) = server.generations.explain()  # read before the connection ends, which discards the decision
    assert len(other.asked) == 1
    assert decision.generation is (
        Generation.YARP_4 if DIALECTS[other.answer] is Profile.YARP4 else Generation.YARP_3_12
    )


@pytest.mark.usefixtures("patient")
def test_replies_are_in_the_clients_dialect(make_port: MakePort, naming: LocalNaming, other: Other) -> None:
    """This holds even if the request has no numbers, whose tags would show the dialect."""
    naming.register("/client", *other.address)

    def on_message(message: PortMessage) -> None:
        assert decode(message.payload) == ["speed"]
        message.reply(encode([1.5], message.peer.profile or Profile.YARP3))

    port = make_port("/server", on_message, rpc=True)
    with call(port.contact, b"/client") as sock:
        assert len(sock.recv(8)) == 8
        expected = encode([1.5], DIALECTS[other.answer])
        assert ask(sock, encode(["speed"], Profile.YARP3), len(expected)) == expected


@pytest.mark.parametrize("name", [b"/nobody", b"anon_rpc", b"/client"])
def test_client_that_cannot_be_queried_gets_a_reply(
    make_port: MakePort, naming: LocalNaming, monkeypatch: pytest.MonkeyPatch, name: bytes
) -> None:
    monkeypatch.setattr("yarp_compat.ports.base.ask_profile", lambda contact: ask_profile(contact, timeout=0.1))
    with socket.create_server(("127.0.0.1", 0)) as mute:
        naming.register("/client", *mute.getsockname())
        port = make_port("/server", lambda message: message.reply(encode(["yes"], Profile.YARP3)), rpc=True)
        with call(port.contact, name) as sock:
            assert len(sock.recv(8)) == 8
            yes = encode(["yes"], Profile.YARP3)
            assert ask(sock, encode(["?"], Profile.YARP3), len(yes)) == yes


def test_port_without_replies_sends_no_queries(make_port: MakePort, naming: LocalNaming, other: Other) -> None:
    naming.register("/client", *other.address)
    port = make_port("/r", lambda _: None)
    with call(port.contact, b"/client") as sock:
        assert len(sock.recv(8)) == 8
    assert other.asked == []


def test_closing_does_not_wait_long_for_a_query(make_port: MakePort, naming: LocalNaming) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        naming.register("/client", *mute.getsockname())
        port = make_port("/server", lambda _: None, rpc=True)
        with call(port.contact, b"/client"):
            until(port.inputs, "the port is connected")
            port.close()


def test_channel_detects_its_servers_release(make_port: MakePort) -> None:
    """A server of 4.0 does not accept a request whose numbers have the tags of 3.12."""
    got = []

    def on_message(message: PortMessage) -> None:
        got.append(bytes(message.payload))
        message.reply(encode([5], Profile.YARP4))

    make_port("/server", on_message, profile=Profile.YARP4)
    client = make_port("/client", rpc=True)
    channel = PortChannel(client, timeout=10)
    assert channel.generation is Generation.YARP_3_12
    assert client.add_output("/server")[0]
    assert channel.generation is Generation.YARP_4
    assert Places(channel).count(2, 3.0) == 5
    assert got == [Places.calls()["count"].request([2, 3.0], Profile.YARP4)]
    channel.generation = Generation.YARP_3_6
    assert channel.generation is Generation.YARP_3_6, "the generation of a reply has priority"
