"""Invalid records from the writer of a lane, by a fault in its process, harm neither this process nor its messages."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.hub.lane import inlet as module
from bridge.hub.lane.inlet import Inlet
from bridge.hub.lane.lent import LentPayload
from bridge.hub.lane.numbering import Receiver
from bridge.hub.lane.wire import BLOCK, DATA, HEAD, LOAN, MARK, ON, PART, PIECE, ROOM, SAMPLE
from bridge.hub.wire.keys import pack_attachment
from bridge.hub.zenoh_config import MAX_PAYLOAD
from tests.support.wait import until

GID = b"g" * 16


class Reader:
    """A subscription."""

    key = "key"
    receiver: Receiver | None = None

    def __init__(self) -> None:
        self.payloads: list[bytes] = []

    def on_message(self, _inlet: Inlet, _attachment: tuple[int, int, bytes], payload: bytes | LentPayload) -> None:
        self.payloads.append(payload if isinstance(payload, bytes) else payload.to_bytes())

    def on_mark(self, inlet: Inlet, gid: bytes, sequence: int) -> None:
        raise NotImplementedError

    def on_fence(self, inlet: Inlet) -> None:
        raise NotImplementedError


class Writer:
    """The writing end of a lane with one subscription, and a file to send."""

    def __init__(self) -> None:
        self.sock, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.sock.settimeout(40)
        self.lost: list[Inlet] = []
        self.inlet = Inlet(far, "zid", self.lost.append, lambda *_: None)
        self.reader = Reader()
        self.inlet.join(self.reader)
        kind, self.key = HEAD.unpack_from(self.sock.recv(ROOM))
        assert kind == ON
        self.file = os.memfd_create("test")

    def send(self, record: bytes, files: int = 0) -> None:
        socket.send_fds(self.sock, [record], [self.file] * files)

    def sample(self, payload: bytes) -> bytes:
        return SAMPLE.pack(DATA, self.key, len(payload), 1, 1, GID) + payload

    def part(self, whole: int, at: int, piece: bytes) -> bytes:
        return HEAD.pack(PART, self.key) + pack_attachment(1, 1, GID) + PIECE.pack(whole, at) + piece

    def received(self) -> list[bytes]:
        """Return all messages once the lane has ended."""
        self.sock.shutdown(socket.SHUT_WR)
        until(lambda: self.lost, "the lane has ended")
        return self.reader.payloads

    def files(self) -> int:
        """Return how many descriptors of the file this process has."""
        wanted, count = os.fstat(self.file), 0
        for entry in Path("/proc/self/fd").iterdir():
            try:
                count += os.path.samestat(entry.stat(), wanted)
            except OSError:  # closed meanwhile
                continue
        return count


@pytest.fixture(params=["in C", "without a compiler"])
def writer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Writer]:
    if request.param != "in C":
        monkeypatch.setattr(module, "read_lane", None)
    end = Writer()
    yield end
    end.sock.close()
    end.inlet.close()
    until(lambda: end.lost, "the lane has ended")
    os.close(end.file)


@pytest.mark.parametrize("files", [1, 2])
@pytest.mark.parametrize("record", [b"", b"\7", b"\2", HEAD.pack(MARK, 99), HEAD.pack(BLOCK, 1), b"sample"])
def test_files_that_come_with_other_records_are_closed(writer: Writer, record: bytes, files: int) -> None:
    writer.send(writer.sample(b"x") if record == b"sample" else record, files)
    writer.received()
    assert writer.files() == 1


def test_a_message_in_parts_is_no_larger_than_it_claims(writer: Writer) -> None:
    writer.send(writer.part(3, 0, b"ab"))
    writer.send(writer.part(3, 2, b"cd"))
    writer.send(writer.sample(b"next"))
    assert writer.received() == [b"next"]


def test_a_message_in_parts_that_claims_to_be_too_large_is_not_stored(writer: Writer) -> None:
    for whole in (4, MAX_PAYLOAD + 1):
        writer.send(writer.part(whole, 0, b"ab"))
        writer.send(writer.part(MAX_PAYLOAD + 1, 2, b"cd"))
    assert writer.received() == []
    assert [key.parts for key in writer.inlet._keys.values()] == [{}]


def test_no_memory_is_allocated_for_a_message_that_claims_to_be_too_large(
    writer: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[int] = []
    monkeypatch.setattr(os, "pread", lambda _file, size, _at: reads.append(size) or b"")
    attachment, loan = pack_attachment(1, 1, GID), LOAN.pack(MAX_PAYLOAD + 1, 1, 1)
    writer.send(HEAD.pack(BLOCK, writer.key) + attachment + loan, files=1)
    until(lambda: writer.lost, "the lane has ended")
    assert (reads, writer.files()) == ([], 1)
