"""The carrier mcast on loopback: against recorded bytes of YARP 4.0, and between Midspan's ports."""

from __future__ import annotations

import gc
import socket
import struct
import threading
from collections.abc import Callable, Iterator

import pytest

from tests.peers.yarp.name_server import RealNameServer
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.datagrams import SendingGroup
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NoNameServerError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.datagrams import Assembler, datagram, split
from yarp_compat.wire.framing import QUIT, prefix
from yarp_compat.wire.profile import Profile

GROUP = "224.1.1.3"
MESSAGE = (
    "59 41 0a 00 00 00 52 50 02 01 ff ff ff ff ff ff ff ff 08 00 00 00 1b 00 00 00 00 00 00 00 00 00 00 00 7e 44 00 01"
    "00 01 00 00 02 00 00 00 04 00 00 00 03 00 00 00 6d 73 67 01 00 00 00"
)
RECORDED = (  # from `yarp write` 4.0 over mcast: the introduction of /w, then two datagrams ("msg" 4), ("msg" 5)
    "59 41 62 1e 00 00 52 50 03 00 00 00 2f 77 00 e0 01 01 03",
    f"80 7f 13 23 00 00 00 00 {MESSAGE} 04 00 00 00",
    f"e5 18 af 9b 00 00 00 00 {MESSAGE} 05 00 00 00",
)


@pytest.fixture(autouse=True)
def _loopback_carries_groups() -> None:
    """Skip in sandboxes whose loopback lacks multicast."""
    port = free_port()
    with member(port) as reader, speaker(port) as writer:
        try:
            writer.send(b"x")
            reader.settimeout(2)
            reader.recv(1)
        except OSError as err:
            pytest.skip(f"multicast does not come through loopback here: {err}")


def member(port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind((GROUP, port))
    membership = struct.pack("4s4s", socket.inet_aton(GROUP), socket.inet_aton("127.0.0.1"))
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    return sock


def speaker(port: int, source: str = "127.0.0.1") -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    sock.bind((source, 0))
    sock.connect((GROUP, port))
    return sock


@pytest.fixture(name="server")
def fixture_server() -> Iterator[RealNameServer]:
    with RealNameServer(free_port(room=20)) as server:
        yield server


class Reader(list[object]):
    """The list of the received values."""

    def __call__(self, message: PortMessage) -> None:
        self.append(decode(message.payload))


@pytest.fixture(name="make")
def fixture_make(server: RealNameServer) -> Iterator[Callable[..., PortCore]]:
    ports: list[PortCore] = []

    def make(name: str, on_message: Reader | None = None) -> PortCore:
        port = PortCore(name, on_message=on_message, naming=NameClient(server.address))
        port.open()
        ports.append(port)
        return port

    yield make
    for port in ports:
        port.close()


def announce_group(port: PortCore, group_port: int) -> None:
    """Send a real writer's introduction, and check that the reader joins the group and then closes the connection."""
    with socket.create_connection((port.contact.host, port.contact.port)) as caller:
        caller.sendall(bytes.fromhex(RECORDED[0]) + struct.pack(">H", group_port))
        caller.settimeout(10)
        assert caller.recv(10) == b""


def test_recorded_datagrams_are_received(make: Callable[..., PortCore]) -> None:
    """The end of a stream (number -1), other machines' datagrams, and garbage are ignored."""
    got, number = Reader(), free_port()
    port = make("/r", got)
    announce_group(port, number)
    until(lambda: port.inputs() == [ConnectionRoute("/w", "/r", "mcast")], "the connection is listed")
    with speaker(number) as writer, speaker(number, "127.0.0.2") as stranger:
        stranger.send(bytes.fromhex(RECORDED[1]))
        writer.send(b"nonsense")
        writer.send(bytes.fromhex("76 68 8a e3 ff ff ff ff") + bytes(10))
        for recorded in RECORDED[1:]:
            writer.send(bytes.fromhex(recorded))
        until(lambda: len(got) == 2, "two messages have arrived")
    assert got == [["msg", 4], ["msg", 5]]
    with socket.create_connection(
        (port.contact.host, port.contact.port)
    ) as sock:  # this is how a companion disconnects
        sock.sendall(b"CONNECT admin\r\n~/w\r\nq\r\n")
        until(lambda: not port.inputs(), "the connection is removed")


def test_messages_of_two_programs_on_one_machine_are_not_mixed(make: Callable[..., PortCore]) -> None:
    """A long message of one program is complete, whatever the other program sends in between."""
    got, number = Reader(), free_port()
    announce_group(make("/r", got), number)
    payload = encode([b"x" * 150_000], Profile.YARP3)
    with speaker(number) as sender, speaker(number) as other:
        for part in split([prefix(len(payload)), payload]):
            sender.send(part)
            other.send(bytes.fromhex(RECORDED[1]))
        until(lambda: [b"x" * 150_000] in got, "the long message has arrived")
    assert got.count(["msg", 4]) >= 2


def test_losses_of_many_sockets_of_one_program_stay_counted(make: Callable[..., PortCore]) -> None:
    """A reader keeps assemblers for at most four senders; losses counted by removed assemblers stay counted."""
    number = free_port()
    port = make("/r", Reader())
    announce_group(port, number)
    until(lambda: bool(port.connections.inputs), "the connection is listed")
    counters = port.connections.inputs[0].counters
    for turn in range(1, 8):
        with speaker(number) as writer:
            writer.send(b"nonsense")
            until(lambda turn=turn: counters.dropped["checksum"] == turn, f"{turn} losses are counted")


def groups() -> list[SendingGroup]:
    """Return all groups of this process."""
    return [item for item in gc.get_objects() if type(item) is SendingGroup]  # weak proxies deceive isinstance


def test_group_that_cannot_be_announced_leaks_no_socket(
    make: Callable[..., PortCore], server: RealNameServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, created = make("/w"), list[SendingGroup]()
    make("/r")
    before = groups()  # left over from earlier tests

    def refused(_name: str) -> None:
        created.extend(group for group in groups() if group not in before)
        raise NoNameServerError

    monkeypatch.setattr(writer.naming, "announce", refused)
    assert not writer.add_output("mcast://r")[0]
    (group,) = created
    with pytest.raises(OSError, match="Bad file descriptor"):
        group.socket()
    assert "mcast" not in [contact.carrier for contact in server.ports.values()]


def test_output_sends_the_same_bytes_as_a_real_one(make: Callable[..., PortCore], server: RealNameServer) -> None:
    """Check the introduction, one datagram for all readers, and the group's registration while it has readers."""
    writer, number = make("/w"), 0
    with socket.create_server(("127.0.0.1", 0)) as acceptor:
        server.client.register("/r", *acceptor.getsockname())
        introductions: list[bytes] = []

        def accept() -> None:
            while b"mcast" not in b"".join(introductions) and not any(h.startswith(b"YAb") for h in introductions):
                sock, _ = acceptor.accept()
                sock.settimeout(20)
                with sock:
                    introductions.append(sock.recv(100))

        thread = threading.Thread(target=accept)
        thread.start()
        done, message = writer.add_output("mcast://r")
        thread.join(20)
    assert (done, message) == (True, "Added connection from /w to mcast://r")
    (group,) = [name for name, contact in server.ports.items() if contact.carrier == "mcast"]
    number = server.ports[group].port
    assert introductions[-1] == bytes.fromhex(RECORDED[0]) + struct.pack(">H", number)
    assert server.client.get_property("/w", "owns") == [group]
    with member(number) as reader:
        reader.settimeout(10)
        assert writer.write(encode(["msg", 4], Profile.YARP3)) == 1
        assert reader.recv(1000) == bytes.fromhex(RECORDED[1])
        assert writer.remove_output("/r")[0]
        assert group not in server.ports
        reader.settimeout(0.05)
        with pytest.raises(TimeoutError):
            reader.recv(1000)


def test_yarp_connect_by_mcast_delivers_messages(make: Callable[..., PortCore], server: RealNameServer) -> None:
    """Two readers, and a third one over tcp: until disconnected, each receives every message once, even a long one."""
    first, second, third = Reader(), Reader(), Reader()
    writer, readers = make("/w"), dict[str, PortCore]()
    for name, got in (("/one", first), ("/two", second), ("/three", third)):
        readers[name] = make(name, got)
        connections.connect(writer.naming, "/w", name, "tcp" if name == "/three" else "mcast")
        # a writer waits for only a second until a reader has joined the group
        until(readers[name].inputs, f"{name} receives messages")
    assert connections.carrier_between(writer.naming, "/w", "/one") == "mcast"
    assert [contact.carrier for contact in server.ports.values()].count("mcast") == 1
    values: list[object] = [[0], [1], [b"y" * 200_000], [2]]
    for value in values:
        assert writer.write(encode(value, Profile.YARP3), wait=True, timeout=10) == 3  # type: ignore[arg-type]
    for got in (first, second, third):
        until(lambda got=got: len(got) == len(values), "all messages have arrived")
        assert got == values
    connections.disconnect(writer.naming, "/w", "/one")
    until(lambda: not readers["/one"].inputs(), "/one has left the group")
    writer.write(encode([3], Profile.YARP3))
    until(lambda: [3] in second, "the other reader still receives messages")
    assert [3] not in first
    connections.disconnect(writer.naming, "/w", "/two")
    assert "mcast" not in [contact.carrier for contact in server.ports.values()]
    assert writer.outputs() == [ConnectionRoute("/w", "/three", "tcp")]


def test_readers_of_two_dialects_do_not_share_a_group(
    make: Callable[..., PortCore], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = make("/w")
    make("/old")
    make("/new").profile = Profile.YARP4
    assert writer.add_output("mcast://old")[0]
    done, message = writer.add_output("mcast://new")
    assert not done
    assert "YARP 3 and YARP 4 cannot share" in message
    assert len(writer.outputs()) == 1


def test_closed_writer_releases_its_group(make: Callable[..., PortCore], server: RealNameServer) -> None:
    got = Reader()
    reader, writer = make("/r", got), make("/w")
    assert writer.add_output("mcast://r")[0]
    writer.close()
    assert set(server.ports) == {"/r"}
    until(lambda: not reader.inputs(), "the reader is notified")


def test_end_of_a_stream_is_not_a_message() -> None:
    """A datagram with the number -1, and a farewell in a datagram."""
    assembler = Assembler()
    assert assembler.add(datagram(b"", -1)) is None
    assert assembler.add(datagram(QUIT, 0)) == QUIT
