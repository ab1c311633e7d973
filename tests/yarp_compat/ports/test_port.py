"""Ports connected to each other: every carrier, envelopes, replies and connections."""

from __future__ import annotations

import errno
import os
import socket
import struct
import subprocess
import sys
import threading
from typing import Any

import pytest

from tests.support.ports import free_port
from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from yarp_compat.ports import connections
from yarp_compat.ports import port as port_module
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Float32

HELLO = encode(["hello", 42, 3.5], Profile.YARP3)
ALL = ["tcp", "fast_tcp", "udp", "text", "text_ack", "local"]
BINARY = ["tcp", "fast_tcp", "udp", "local"]


class Reader:
    """A record of a port's messages."""

    def __init__(self) -> None:
        self.got: list[tuple[list[Any], str]] = []

    def __call__(self, message: PortMessage) -> None:
        self.got.append((decode(message.payload), message.envelope))


@pytest.mark.parametrize("carrier", ALL)
def test_a_message_arrives_with_its_envelope(make_port: MakePort, carrier: str) -> None:
    reader = Reader()
    make_port("/r", reader)
    writer = make_port("/w")
    assert writer.add_output(f"{carrier}://r") == (True, f"Added connection from /w to {carrier}://r")
    assert writer.write(HELLO, "7 1795143618.02289", wait=True, timeout=10) == 1
    until(lambda: reader.got, "the message has arrived")
    assert reader.got == [(["hello", 42, 3.5], "7 1795143618.02289")]
    assert writer.outputs() == [ConnectionRoute("/w", "/r", carrier)]


@pytest.mark.parametrize("carrier", ALL)
def test_a_message_arrives_without_an_envelope(make_port: MakePort, carrier: str) -> None:
    reader = Reader()
    make_port("/r", reader)
    writer = make_port("/w")
    writer.add_output(f"{carrier}://r")
    writer.write(HELLO, strict=True)
    until(lambda: reader.got, "the message has arrived")
    assert reader.got == [(["hello", 42, 3.5], "")]


@pytest.mark.parametrize("carrier", BINARY)
@pytest.mark.parametrize("size", [0, 1, 1 << 15, (1 << 15) + 1, 100_000])
def test_messages_of_all_sizes_arrive(make_port: MakePort, carrier: str, size: int) -> None:
    got: list[bytes] = []
    make_port("/r", lambda m: got.append(bytes(m.payload)))
    writer = make_port("/w")
    writer.add_output(f"{carrier}://r")
    sent = bytes(range(256)) * (size // 256) + bytes(size % 256)
    writer.write([sent[:10], memoryview(sent)[10:]], wait=True, timeout=10)
    until(lambda: got, "the message has arrived")
    assert got == [sent]


def test_large_messages_do_not_share_memory(make_port: MakePort, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is reused only when it is no longer referenced."""
    monkeypatch.setattr(port_module, "_KEPT_FOR", 1000.0)
    kept: list[memoryview] = []
    addresses = []

    def on_message(message: PortMessage) -> None:
        assert isinstance(message.payload, memoryview)
        assert not message.payload.readonly
        addresses.append(id(message.payload.obj))
        if message.payload[0] % 2:
            kept.append(message.payload)

    make_port("/r", on_message)
    writer = make_port("/w")
    writer.add_output("/r")
    for i in range(6):
        writer.write(bytes([i]) * 3_000_000, wait=True, timeout=10)
    assert [view[-1] for view in kept] == [1, 3, 5]
    assert addresses[0] == addresses[1]
    assert addresses[2] != addresses[1]


def test_a_message_in_many_blocks_is_joined(make_port: MakePort) -> None:
    """C++ programs send large objects in several blocks."""
    import struct

    got: list[bytes] = []
    port = make_port("/r", lambda m: got.append(bytes(m.payload)))
    blocks = [b"\0\0\0\0~D\0\1", b"ab", b"", b"c" * 70_000, b"de"]
    head = b"YA\x0a\0\0\0RP" + bytes([len(blocks), 1]) + b"\xff" * 8
    with socket.create_connection((port.contact.host, port.contact.port)) as sock:
        sock.sendall(b"YAd\x1e\0\0RP\x03\0\0\0/w\0")
        sock.sendall(head + struct.pack("<5i", *map(len, blocks)) + bytes(4) + b"".join(blocks))
        until(lambda: got, "the message has arrived")
    assert got == [b"ab" + b"c" * 70_000 + b"de"]


def test_all_connected_readers_receive_a_message(make_port: MakePort) -> None:
    readers = [Reader() for _ in range(len(ALL))]
    writer = make_port("/w")
    for i, (carrier, reader) in enumerate(zip(ALL, readers, strict=True)):
        make_port(f"/r{i}", reader)
        assert writer.add_output(f"{carrier}://r{i}")[0]
    assert writer.write(HELLO, "1 2", wait=True, timeout=10) == len(ALL)
    for reader in readers:
        until(lambda got=reader.got: got == [(["hello", 42, 3.5], "1 2")], "the message has arrived")


def test_each_reader_receives_its_dialect(make_port: MakePort) -> None:
    got: dict[str, bytes] = {}
    writer = make_port("/w")
    for name in ("/three", "/four"):
        make_port(name, lambda m: got.update({m.peer.route.target: bytes(m.payload)}))
        writer.add_output(name)
    writer.connections.outputs[1].profile = Profile.YARP4
    writer.write(lambda profile: encode([1.5, "a"], profile), wait=True, timeout=10)
    assert got == {"/three": encode([1.5, "a"], Profile.YARP3), "/four": encode([1.5, "a"], Profile.YARP4)}


def test_connecting_again_replaces_the_output(make_port: MakePort) -> None:
    reader = make_port("/r", Reader())
    writer = make_port("/w")
    for carrier in ("tcp", "fast_tcp", "tcp", "udp", "text"):
        assert writer.add_output(f"{carrier}://r")[0]
        assert writer.outputs() == [ConnectionRoute("/w", "/r", carrier)]
        until(
            lambda c=carrier: reader.inputs() == [ConnectionRoute("/w", "/r", c)],
            f"only the {carrier} connection is left",
        )


def test_second_connection_of_a_port_replaces_the_first(make_port: MakePort) -> None:
    """A port may reconnect before the end of its old connection is detected.

    Names without a slash belong to tools, and several tools may have the same one, so their connections stay.
    """
    port = make_port("/r", Reader())
    socks = []
    for name in (b"/w\0", b"/v\0", b"/w\0", b"ad\0", b"ad\0"):
        socks.append(socket.create_connection((port.contact.host, port.contact.port)))
        socks[-1].sendall(b"YAd\x1e\0\0RP\x03\0\0\0" + name)
        assert len(socks[-1].recv(8)) == 8
    until(
        lambda: sorted(r.source for r in port.inputs()) == ["/v", "/w", "ad", "ad"],
        "one connection of each port is left",
    )
    socks[0].settimeout(10)
    assert socks[0].recv(1) == b""
    for sock in socks:
        sock.close()


def test_either_end_can_disconnect(make_port: MakePort) -> None:
    reader = make_port("/r", Reader())
    writer = make_port("/w")
    for carrier in ALL:
        writer.add_output(f"{carrier}://r")
        until(reader.inputs, "the reader is connected")
        assert writer.remove_output("/r") == (True, "Removed connection from /w to /r")
        until(lambda: not reader.inputs(), f"the reader detects the end of {carrier}")
    for carrier in ("tcp", "fast_tcp", "text", "text_ack", "local"):
        writer.add_output(f"{carrier}://r")
        until(reader.inputs, "the reader is connected")
        assert reader.remove_input("/w") == (True, "Removing connection from /w to /r")
        until(lambda: not writer.outputs(), f"the writer detects the end of {carrier}")
    assert writer.remove_output("/r") == (False, "Could not find an outgoing connection to /r")
    assert reader.remove_input("/w") == (False, "Could not find an incoming connection from /w")


def test_writer_detects_a_closed_reader(make_port: MakePort) -> None:
    writer = make_port("/w")
    for carrier in ("tcp", "fast_tcp", "text_ack"):
        reader = make_port("/r", Reader())
        writer.add_output(f"{carrier}://r")
        reader.close()
        until(lambda: not writer.outputs(), f"the writer detects the end of the {carrier} reader")
    reader = make_port("/r", Reader())
    writer.add_output("udp://r")
    until(reader.inputs, "the reader is connected")
    reader.close()

    def disconnected() -> bool:
        writer.write(HELLO)
        return not writer.outputs()

    until(disconnected, "the writer is disconnected because the machine rejects its udp datagrams")


def test_both_ends_report_a_connection_and_its_end(make_port: MakePort) -> None:
    events: list[ConnectionEvent] = []
    reader = make_port("/r", on_event=events.append)
    writer = make_port("/w", on_event=events.append)
    writer.add_output("/r")
    until(reader.inputs, "the reader is connected")
    writer.remove_output("/r")
    until(lambda: len(events) == 4, "four events have arrived")
    route = ConnectionRoute("/w", "/r", "tcp")
    assert sorted(events, key=lambda e: (not e.up, e.incoming)) == [
        ConnectionEvent(route, incoming=False, up=True), ConnectionEvent(route, incoming=True, up=True),
        ConnectionEvent(route, incoming=False, up=False), ConnectionEvent(route, incoming=True, up=False),
    ]  # fmt: skip


def test_rpc_client_has_one_server(make_port: MakePort) -> None:
    make_port("/a")
    make_port("/b")
    client = make_port("/c", rpc=True)
    assert client.add_output("/a")[0]
    assert client.add_output("/b") == (False, "RPC output already connected")
    assert client.add_output("/a")[0], "a new connection to the same server replaces the old one"


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("/nowhere", "Do not know how to connect to /nowhere"),
        ("mcast://r", "Cannot connect to mcast://r: the name server allocated no IPv4 multicast group"),
        ("shmem:/r", "Cannot connect to shmem:/r"),
        ("nonsense://r", "Cannot connect to nonsense://r"),
        ("http://r", "Cannot connect to http://r"),
    ],
)
def test_impossible_connections_are_refused(
    make_port: MakePort, target: str, expected: str, caplog: pytest.LogCaptureFixture
) -> None:
    make_port("/r")
    done, message = make_port("/w").add_output(target)
    assert not done
    assert message.startswith(expected)
    if target.startswith(("shmem", "http")):
        assert "not supported; use one of tcp, fast_tcp" in caplog.text


@pytest.mark.parametrize(
    "target",
    ["tcp+recv.portmonitor+type.dll://r", "tcp+send.portmonitor+type.dll://r", "udp+log.in://r", "tcp+nonsense://r"],
)
def test_carrier_modifiers_are_refused(make_port: MakePort, target: str, caplog: pytest.LogCaptureFixture) -> None:
    """Midspan's ports cannot modify messages, and the peer would mistake unmodified messages for modified ones."""
    reader = make_port("/r")
    writer = make_port("/w")
    done, message = writer.add_output(target)
    assert not done
    assert message.startswith(f"Cannot connect to {target}")
    assert not writer.outputs()
    until(lambda: not reader.inputs(), "no input is left")
    if "recv" in target:
        until(lambda: "carrier modifier (recv portmonitor) (type dll)" in caplog.text, "the reader logs the reason")
    else:
        assert "does not support carrier modifiers" in message


@pytest.mark.parametrize("first", [b"YA\xe4\x1e\0\0RP", b"YAd\x1e\0\0RP", b"YAa\x1e\0\0RP", b"CONNACK "])
def test_modifier_of_the_writer_is_accepted(make_port: MakePort, first: bytes) -> None:
    """A C++ port that connects with ``send.portmonitor`` modifies its messages itself; ``recv`` is refused.

    The C++ port accepts any eight bytes as an answer (``TcpCarrier::expectReplyToHeader``): after a refusal in words,
    ``yarp connect`` of 3.9.1 reported "Success", so only the text carriers get an answer to a refused connection.
    """
    reader = make_port("/r")
    for qualifiers, taken in ((b"(send portmonitor) (type dll)", True), (b"(send x) (recv y)", False)):
        with socket.create_connection((reader.contact.host, reader.contact.port)) as sock:
            name = b"/w " + qualifiers
            text = name + b"\r\n" if first == b"CONNACK " else struct.pack("<i", len(name) + 1) + name + b"\0"
            sock.sendall(first + text)
            sock.settimeout(10)
            answer = sock.recv(100)
        if taken or first == b"CONNACK ":
            assert answer.startswith((b"YA", b"Welcome") if taken else b"* Error")
        else:
            assert answer == b""


def test_local_is_for_one_process(make_port: MakePort, naming: LocalNaming) -> None:
    other = PortCore("/elsewhere", naming=naming)
    other.open()
    naming.register("/here", other.contact.host, other.contact.port)
    writer = make_port("/w")
    assert writer.add_output("local://here") == (False, "Cannot connect to local://here")
    other.close()


def test_input_port_refuses_outputs(make_port: MakePort) -> None:
    make_port("/r")
    assert make_port("/w", is_output=False).add_output("/r") == (False, "Outputs not allowed")


def test_interrupted_port_drops_messages(make_port: MakePort) -> None:
    reader = Reader()
    port = make_port("/r", reader)
    writer = make_port("/w")
    writer.add_output("/r")
    port.interrupt()
    writer.write(HELLO, wait=True, timeout=10)
    assert port.counters.dropped["interrupted"] == 1
    port.resume()
    writer.write(HELLO, wait=True, timeout=10)
    assert len(reader.got) == 1


def test_owner_can_end_the_connection_after_a_message(make_port: MakePort) -> None:
    def on_message(message: PortMessage) -> None:
        message.reply(HELLO)
        message.drop()

    server = make_port("/server", on_message)
    client = make_port("/client")
    client.add_output("/server")
    assert client.request(HELLO, timeout=10) == HELLO
    until(lambda: not server.inputs(), "the connection ends")


def test_text_is_made_only_for_text_readers(make_port: MakePort) -> None:
    reader = Reader()
    make_port("/r", reader)
    writer = make_port("/w")
    writer.add_output("tcp://r")
    writer.write(HELLO, wait=True, timeout=10, text=lambda: pytest.fail("nobody reads text"))
    writer.add_output("text_ack://r")
    writer.write(HELLO, wait=True, timeout=10, text=lambda: "made 1")
    assert reader.got == [(["hello", 42, 3.5], ""), (["made", 1], "")]


def test_text_reader_does_not_affect_others(make_port: MakePort) -> None:
    """A message that is not a Bottle is dropped for the text reader and reaches the others."""
    got: list[bytes] = []
    text = Reader()
    make_port("/text", text)
    make_port("/binary", lambda m: got.append(bytes(m.payload)))
    writer = make_port("/w")
    writer.add_output("text_ack://text")
    writer.add_output("tcp://binary")
    assert writer.write(b"no Bottle", wait=True, timeout=10) == 1
    assert writer.write(HELLO, wait=True, timeout=10) == 2
    assert got == [b"no Bottle", HELLO]
    assert len(text.got) == 1
    assert writer.counters.dropped == {"no text": 1}


@pytest.mark.parametrize("carrier", ["tcp", "text_ack"])
def test_envelopes_are_one_line(make_port: MakePort, carrier: str) -> None:
    reader = Reader()
    make_port("/r", reader)
    writer = make_port("/w")
    writer.add_output(f"{carrier}://r")
    writer.write(HELLO, "1 2.5\r\nq\r\n", wait=True, timeout=10)
    assert reader.got == [(["hello", 42, 3.5], "1 2.5")]


def test_outputs_are_bounded(make_port: MakePort, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MOST_OUTPUTS", 2)
    writer = make_port("/w")
    done = [writer.add_output(make_port(f"/r{i}").name)[0] for i in range(3)]
    assert done == [True, True, False]


FORK = """
import os, sys
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import encode
from yarp_compat.wire.profile import Profile
naming, hello = LocalNaming(), encode(["hello"], Profile.YARP3)
def pair(name):
    reader = PortCore(f"/{name}/r", on_message=lambda m: m.reply(m.payload), naming=naming)
    writer = PortCore(f"/{name}/w", naming=naming)
    reader.open(), writer.open()
    assert writer.add_output(f"/{name}/r")[0]
    assert writer.request(hello, timeout=10) == hello
    return reader, writer
reader, writer = pair("parent")
descriptors = len(os.listdir("/proc/self/fd"))
child = os.fork()
if not child:
    assert not reader.is_open and not writer.outputs()
    assert len(os.listdir("/proc/self/fd")) < descriptors, "the child has closed the descriptors of its parent"
    for port in pair("child"):
        port.close()
    reader.close()
    os._exit(7)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
assert writer.request(hello, timeout=10) == hello, "the parent's connections are as they were"
reader.close(), writer.close()
print("well")
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_process_opens_its_own_ports() -> None:
    """The child does not share the parent's ports, and can open its own."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORK], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout == "well\n", done.stderr


def test_port_gets_the_requested_number_and_name(naming: LocalNaming) -> None:
    from tests.support.ports import free_port

    number = free_port()
    port = PortCore("...", naming=naming, number=number)
    contact = port.open()
    assert contact.port == number
    assert contact.name.startswith("/tmp/port/")
    second = PortCore("/second", naming=naming, number=number)
    with pytest.raises(OSError, match="in use"):
        second.open()
    assert naming.query("/second") is None
    port.close()
    port.close()
    assert naming.query(contact.name) is None


@pytest.mark.parametrize("profile", list(Profile))
@pytest.mark.parametrize("carrier", ["text", "text_ack"])
def test_text_is_converted_to_the_readers_dialect(make_port: MakePort, carrier: str, profile: Profile) -> None:
    """A message in a port's dialect becomes a line, and the line a Bottle in the reader's dialect."""
    got: list[bytes] = []
    make_port("/r", lambda m: got.append(bytes(m.payload)), profile=profile)
    writer = make_port("/w", profile=profile)
    writer.add_output(f"{carrier}://r")
    writer.write(encode([Float32(1.5), Float32(2.5)], profile), strict=True)
    until(lambda: got, "the message has arrived")
    assert got == [encode([1.5, 2.5], profile)]


def yarp_threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name.startswith("yarp")}


def test_port_whose_number_another_socket_takes_leaks_nothing(
    naming: LocalNaming, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two sockets can bind the same number until one listens. If the number is not fixed, the port chooses another."""
    listen, taken = socket.socket.listen, list[int]()

    def taken_once(sock: socket.socket, *args: int) -> None:
        if not taken:
            taken.append(sock.fileno())
            raise OSError(errno.EADDRINUSE, "in use")
        listen(sock, *args)

    monkeypatch.setattr(socket.socket, "listen", taken_once, raising=False)
    port = PortCore("/p", naming=naming, number=free_port())
    before = yarp_threads()
    with pytest.raises(OSError, match="in use"):
        port.open()
    assert not port.is_open
    assert naming.query("/p") is None
    assert yarp_threads() <= before
    taken.clear()
    port = PortCore("/p", naming=naming)
    port.open()
    assert port.is_open
    port.close()


def test_port_that_cannot_be_announced_is_not_open(naming: LocalNaming, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str, alive: bool = True) -> None:
        raise ConnectionRefusedError

    monkeypatch.setattr(naming, "announce", refuse)
    port = PortCore("/p", naming=naming)
    with pytest.raises(ConnectionRefusedError):
        port.open()
    assert not port.is_open
    assert naming.query("/p") is None
