"""Messages for a slow peer: only the newest one or all are queued, and other peers are not delayed."""

from __future__ import annotations

import socket
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator

import pytest

from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from yarp_compat.ports import connecting, loop, port
from yarp_compat.ports.connections import AnyOutput
from yarp_compat.ports.datagrams import DatagramOutput
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.wire import framing
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.profile import Profile

BIG = 300_000
HELLO = encode(["hello"], Profile.YARP3)


class Slow:
    """A peer that introduces itself as a port and reads only on demand."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16384)
        self.sock: socket.socket | None = None
        self._thread = threading.Thread(target=self._accept)
        self._thread.start()

    def _accept(self) -> None:
        self.server.settimeout(10)
        self.sock, _ = self.server.accept()
        self.sock.settimeout(10)
        self.sock.recv(100)
        self.sock.sendall(b"YA\0\0\0\0RP")

    def read(self) -> bytes:
        """Return the payload of the next message."""
        assert self.sock is not None
        index = b""
        while len(index) < 30:
            index += self.sock.recv(30 - len(index))
        size = framing.body_size(index)
        body = b""
        while len(body) < size:
            body += self.sock.recv(size - len(body))
        return body[8:]

    def acknowledge(self) -> None:
        assert self.sock is not None
        self.sock.sendall(framing.ACK)

    def close(self) -> None:
        self._thread.join()
        self.server.close()
        if self.sock is not None:
            self.sock.close()


@pytest.fixture
def slow(naming: LocalNaming) -> Iterator[Slow]:
    peer = Slow()
    naming.register("/slow", *peer.server.getsockname())
    yield peer
    peer.close()


def test_slow_peer_receives_only_the_newest_message(make_port: MakePort, slow: Slow) -> None:
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    for i in range(10):
        assert writer.write(b"%d" % i) == 1
    assert slow.read() == b"0"
    slow.acknowledge()
    assert slow.read() == b"9"
    slow.acknowledge()
    until(lambda: not writer.is_writing, "all messages are sent")
    assert writer.connections.outputs[0].counters.dropped["replaced"] == 8


def test_strict_writes_are_all_delivered(make_port: MakePort, slow: Slow) -> None:
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    for i in range(10):
        assert writer.write(b"%d" % i, strict=True) == 1
    assert not writer.wait_writes(0.05)
    for i in range(10):
        assert slow.read() == b"%d" % i
        slow.acknowledge()
    assert writer.wait_writes(10)
    assert not writer.is_writing


def test_rest_of_a_message_is_sent_although_select_is_full(
    make_port: MakePort, slow: Slow, fill_select: Callable[[], None]
) -> None:
    writer = make_port("/w")
    writer.add_output("/slow")
    fill_select()
    big = encode([bytes([1]) * (10 * BIG)], Profile.YARP3)
    writer.write(big)
    writer.write(HELLO, strict=True)
    assert slow.read() == big
    slow.acknowledge()
    assert slow.read() == HELLO
    slow.acknowledge()
    output = writer.connections.outputs[0]
    until(lambda: not output.busy, "the shared thread has read the last acknowledgment")


def test_peer_that_has_acknowledged_is_not_busy(
    make_port: MakePort, slow: Slow, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The acknowledgment is read on demand, not only by the periodic check, because commands skip busy peers."""
    monkeypatch.setattr(loop, "_CHECK_PERIOD", 1000.0)
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    (output,) = writer.connections.outputs
    for i in range(3):
        assert writer.write(b"%d" % i, chosen=lambda output: not output.busy) == 1
        assert output.busy
        assert writer.write(b"not heard", chosen=lambda output: not output.busy) == 0
        assert slow.read() == b"%d" % i
        slow.acknowledge()
        until(lambda: not output.busy, "the acknowledgment is read")


def test_peer_is_not_busy_during_the_periodic_check(make_port: MakePort, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command written while the connection is checked reaches the reader."""
    monkeypatch.setattr(loop, "_CHECK_PERIOD", 1000.0)
    got: list[bytes] = []
    make_port("/r", lambda m: got.append(bytes(m.payload)))
    writer = make_port("/w")
    writer.add_output("fast_tcp://r")
    (output,) = writer.connections.outputs
    is_connected, queried = output.socket_side.is_connected, threading.Event()

    def idle(output: AnyOutput) -> bool:
        free = not output.busy
        queried.set()
        return free

    command = threading.Thread(target=lambda: writer.write(b"go", chosen=idle))

    def checking() -> bool:
        command.start()
        assert queried.wait(20)
        return is_connected()

    monkeypatch.setattr(output.socket_side, "is_connected", checking)
    output.check()
    command.join(20)
    until(lambda: got == [b"go"], "the command has arrived")


@pytest.mark.parametrize("strict", [False, True])
def test_writer_of_a_dropped_message_returns(make_port: MakePort, slow: Slow, strict: bool) -> None:
    """The message is replaced by a newer one, or dropped because others fill the queue."""
    writer = make_port("/w", limit=3 * BIG)
    writer.add_output("tcp://slow")
    for _ in range(2):
        assert writer.write(b"a", strict=True) == 1, "the shared thread waits for the acknowledgment"
    (output,) = writer.connections.outputs
    reached: list[int] = []
    waiting = threading.Thread(target=lambda: reached.append(writer.write(b"b", wait=True, timeout=20)))
    waiting.start()
    until(lambda: output.waiters, "the writer is waiting")
    began = time.monotonic()
    for _ in range(3):
        writer.write(bytes(BIG), strict=strict)
    waiting.join(30)
    assert reached == [0]
    assert time.monotonic() - began < 15


def test_message_that_cannot_be_encoded_for_one_reader_reaches_the_others(make_port: MakePort) -> None:
    """The writer raises at once; the other connections are free for the next message."""
    got: list[bytes] = []
    make_port("/a", lambda m: got.append(bytes(m.payload)))
    make_port("/b", lambda _: None)
    writer = make_port("/w")
    for name in ("a", "b"):
        writer.add_output(f"tcp://{name}")
    writer.connections.outputs[1].profile = Profile.YARP4

    def content(profile: Profile) -> bytes:
        if profile is Profile.YARP4:
            raise WireError
        return HELLO

    with pytest.raises(WireError):
        writer.write(content, wait=True, timeout=20)
    assert writer.wait_writes(20)
    assert writer.write(HELLO, wait=True, timeout=20) == 2
    assert got == [HELLO, HELLO]


def test_send_queue_is_bounded(make_port: MakePort, slow: Slow) -> None:
    writer = make_port("/w", limit=10 * BIG)
    writer.add_output("tcp://slow")
    for i in range(30):
        assert writer.write(bytes([i]) * BIG, strict=True) == 1
    dropped = writer.connections.outputs[0].counters.dropped["full"]
    assert 17 < dropped < 25
    received = []
    for _ in range(30 - dropped):
        received.append(slow.read()[0])
        slow.acknowledge()
    assert received == [0, *range(dropped + 1, 30)], "the oldest queued messages are dropped"


def test_large_messages_do_not_make_the_queue_large(
    make_port: MakePort, slow: Slow, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A port that accepts messages of a gigabyte does not queue a gigabyte for each peer."""
    monkeypatch.setattr(connecting, "QUEUE", 3 * BIG)
    writer = make_port("/w", limit=1 << 30)
    writer.add_output("tcp://slow")
    for _ in range(10):
        assert writer.write(bytes(BIG), strict=True) == 1
    dropped = writer.connections.outputs[0].counters.dropped
    assert dropped["full"] == 10 - 1 - 2, (
        "one message is being sent, and because of the overhead two more fit in the queue"
    )
    assert writer.write(bytes(4 * BIG), strict=True) == 1
    assert dropped["full"] == 10 - 1, "one message always fits, however large"


def test_overhead_of_small_messages_counts(make_port: MakePort, slow: Slow) -> None:
    limit = 1 << 20
    writer = make_port("/w", limit=limit)
    writer.add_output("tcp://slow")
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(30_000):
            writer.write(b"x", strict=True)
        assert tracemalloc.get_traced_memory()[0] - before < 2 * limit
    finally:
        tracemalloc.stop()
    assert writer.connections.outputs[0].counters.dropped["full"] > 20_000


@pytest.mark.parametrize("carrier", ["tcp", "fast_tcp"])
def test_queued_message_may_be_changed_by_its_owner(make_port: MakePort, slow: Slow, carrier: str) -> None:
    """A queued or partly sent message is a copy."""
    writer = make_port("/w")
    writer.add_output(f"{carrier}://slow")
    memory = bytearray(8_000_000)
    for i in (1, 2):
        memory[:] = bytes([i]) * len(memory)
        assert writer.write(memory, strict=True) == 1
    memory[:] = b"\xff" * len(memory)
    for i in (1, 2):
        assert slow.read() == bytes([i]) * len(memory)
        if carrier == "tcp":
            slow.acknowledge()


def test_slow_peer_does_not_delay_others(make_port: MakePort, slow: Slow) -> None:
    """The slow peer reads nothing at all; another peer receives every message at once."""
    got: list[int] = []
    make_port("/quick", lambda m: got.append(decode(m.payload[: len(m.payload) - BIG])[0]))
    writer = make_port("/w")
    writer.add_output("fast_tcp://slow")
    writer.add_output("tcp://quick")
    start = time.monotonic()
    for i in range(50):
        writer.write([encode([i], Profile.YARP3), bytes(BIG)], strict=False)
        until(lambda n=i: len(got) == n + 1, "the quick peer receives the message")
    assert got == list(range(50))
    assert time.monotonic() - start < 30, "the writer did not block"


def test_waiting_for_a_slow_peer_ends_in_time(make_port: MakePort, slow: Slow) -> None:
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    start = time.monotonic()
    assert writer.write(b"a", wait=True, timeout=0.3) == 0
    assert 0.3 <= time.monotonic() - start < 10
    assert slow.read() == b"a"
    slow.acknowledge()
    until(lambda: not writer.is_writing, "the acknowledgment is still read")
    threading.Timer(0.2, lambda: (slow.read(), slow.acknowledge())).start()
    assert writer.write(b"b", wait=True, timeout=10) == 1


def test_writer_returns_when_its_peer_leaves(make_port: MakePort, slow: Slow) -> None:
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    threading.Timer(0.2, lambda: slow.sock and slow.sock.close()).start()
    assert writer.write(b"a", wait=True, timeout=20) == 0
    assert writer.outputs() == []


def test_writer_of_a_queued_message_returns_after_the_peer_is_unlisted(
    make_port: MakePort, slow: Slow, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    (output,), listed = writer.connections.outputs, list[int]()
    close = output.socket_side.close  # runs after the writer has returned
    monkeypatch.setattr(output.socket_side, "close", lambda: (listed.append(len(writer.outputs())), close()))
    assert writer.write(b"a") == 1
    assert writer.write(b"waits") == 1, "the shared thread waits for the previous acknowledgment"
    threading.Timer(0.2, lambda: slow.sock and slow.sock.close()).start()
    assert writer.write(b"b", wait=True, timeout=20) == 0
    assert until(lambda: listed, "the peer's socket is closed")[0] == 0


@pytest.mark.parametrize("carrier", ["tcp", "udp"])
def test_closed_output_is_not_listed(make_port: MakePort, monkeypatch: pytest.MonkeyPatch, carrier: str) -> None:
    """A writer whose message fails sees the peer as disconnected."""
    make_port("/r")
    writer = make_port("/w")
    remove, closed = writer.connections.remove_output, list[bool]()

    def removing(output: AnyOutput) -> bool:
        closed.append(output.closed)
        return remove(output)

    monkeypatch.setattr(writer.connections, "remove_output", removing)
    writer.add_output(f"{carrier}://r")
    (output,) = writer.connections.outputs
    if isinstance(output, DatagramOutput):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
            nobody.bind(("127.0.0.1", 0))
            output.sock.connect(nobody.getsockname())
        output.sock.send(b"refused")
    else:
        output.socket_side.shutdown()
    output.check()
    until(lambda: output.closed, "the output is closed")
    assert closed == [False]
    assert writer.outputs() == []


def test_closing_releases_a_waiting_writer(make_port: MakePort, slow: Slow) -> None:
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    threading.Timer(0.2, writer.close).start()
    assert writer.write(b"a", wait=True, timeout=20) == 0
    until(lambda: not writer.is_open, "the writer is closed")


def test_invalid_acknowledgment_closes_the_connection(make_port: MakePort, slow: Slow) -> None:
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    writer.write(b"a")
    assert slow.read() == b"a"
    assert slow.sock is not None
    slow.sock.sendall(b"certainly not")
    until(lambda: not writer.outputs(), "the connection is closed")


def test_request_that_is_only_acknowledged_is_an_error(make_port: MakePort, slow: Slow) -> None:
    """C++ readers without a reply only acknowledge the request; the connection stays open."""
    client = make_port("/c")
    client.add_output("tcp://slow")
    for _ in range(2):
        threading.Timer(0.05, lambda: (slow.read(), slow.acknowledge())).start()
        with pytest.raises(WireError, match="without replying"):
            client.request(HELLO, timeout=10)
    threading.Timer(0.05, lambda: (slow.read(), slow.sock and slow.sock.sendall(HELLO + framing.ACK))).start()
    assert client.request(HELLO, timeout=10) == HELLO


@pytest.mark.parametrize("profile", list(Profile))
def test_a_long_reply_in_pieces_is_joined(make_port: MakePort, slow: Slow, profile: Profile) -> None:
    """The end and the dialect of the reply are detected while it arrives."""
    client = make_port("/c")
    client.add_output("tcp://slow")
    reply = encode([["text", 1.5, i, "x" * 100] for i in range(20_000)], profile)

    def answer() -> None:
        slow.read()
        assert slow.sock is not None
        for at in range(0, len(reply), 50_000):
            slow.sock.sendall(reply[at : at + 50_000])
        slow.acknowledge()

    threading.Timer(0.05, answer).start()
    assert client.request(HELLO, timeout=20) == reply
    assert client.connections.outputs[0].profile is profile


def test_caller_can_parse_the_end_of_a_reply(make_port: MakePort, slow: Slow) -> None:
    """Some replies of thrift servers are not Bottles."""
    client = make_port("/c")
    client.add_output("tcp://slow")
    sent = b"\1\0\0\0\7\0\0\0" + framing.ACK
    threading.Timer(0.05, lambda: (slow.read(), slow.sock and slow.sock.sendall(sent))).start()

    def end(data: bytes) -> int:
        if len(data) < 8:
            raise Incomplete
        return 8

    assert client.request(HELLO, timeout=10, parse=end) == sent[:8]


def test_reply_above_the_limit_is_an_error(make_port: MakePort, slow: Slow) -> None:
    client = make_port("/c", limit=100_000)
    client.add_output("tcp://slow")
    reply = encode(["x" * 50_000, "y" * 100_000], Profile.YARP3)
    threading.Timer(0.05, lambda: (slow.read(), slow.sock and slow.sock.sendall(reply))).start()
    with pytest.raises(WireError, match="limit"):
        client.request(HELLO, timeout=10)
    assert client.outputs() == []


def test_many_threads_write_to_one_port(make_port: MakePort) -> None:
    """Whether writers block or not, every strict message arrives once and complete."""
    got: list[int] = []
    make_port("/r", lambda m: got.append(decode(m.payload)[0]))
    writer = make_port("/w")
    writer.add_output("tcp://r")

    def write(first: int) -> None:
        for i in range(first, first + 100):
            writer.write(encode([i, "x" * (i % 7) * 5000], Profile.YARP3), strict=True, wait=i % 3 == 0)

    threads = [threading.Thread(target=write, args=(n * 100,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert writer.wait_writes(10)
    assert sorted(got) == list(range(400))
    for n in range(4):
        assert [g for g in got if g // 100 == n] == list(range(n * 100, n * 100 + 100)), (
            "the messages of each thread are in order"
        )


def test_messages_lost_by_a_closed_output_stay_counted(make_port: MakePort, slow: Slow) -> None:
    """The output is removed with its counters, but the port still reports how many messages were lost, and why."""
    writer = make_port("/w")
    writer.add_output("tcp://slow")
    (output,) = writer.connections.outputs
    for i in range(3):
        writer.write(bytes([i]) * 5_000_000, strict=True)
    assert slow.sock is not None
    slow.sock.close()
    until(lambda: writer.lost["lost"] == 3, "all three messages are counted as lost")
    assert output.counters.dropped["lost"] == 3
    assert writer.connections.outputs == []


def test_message_above_the_limit_is_counted_as_large(make_port: MakePort) -> None:
    """A C++ port only sees the connection close; the counter shows the reason."""
    reader = make_port("/r", limit=1_000_000)
    writer = make_port("/w")
    writer.add_output("tcp://r")
    writer.write(encode([b"x" * 1_000_001], Profile.YARP3))
    until(lambda: reader.counters.dropped == {"large": 1}, "the message is counted")


def test_memory_of_a_large_message_is_freed(make_port: MakePort, monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory is kept for the next large message for a few seconds only."""
    monkeypatch.setattr(port, "_KEPT_FOR", 0.0)
    got: list[int] = []
    reader = make_port("/r", lambda m: got.append(len(m.payload)))
    writer = make_port("/w")
    writer.add_output("tcp://r")
    for count in (1, 2):
        writer.write(encode([b"x" * 20_000_000], Profile.YARP3), wait=True, timeout=20)
        until(lambda count=count: len(got) == count, "the message arrives")
        (connection,) = reader.connections.inputs
        until(lambda connection=connection: not connection.stream.kept, "the memory of the message is freed")
