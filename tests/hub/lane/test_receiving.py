"""A lane's messages are handed to an acceptor in C if they are plain, and otherwise to Python."""

from __future__ import annotations

import gc
import random
import socket
import struct
import threading
import weakref
from collections.abc import Callable
from typing import Any

import pytest

from bridge.hub.lane.receiving import Receiver, Track, read_lane
from bridge.hub.lane.wire import DATA, HEAD, MARK, ROOM, SAMPLE
from tests.peers.native import GID, RecordingAcceptor, RecordingOutput, exit_to, foreign_capsule

KEY, TIME, LIMIT = 3, 5, 100
LAST = 2**63 - 1
OTHER = b"o" * 16


def message(
    sequence: int, payload: bytes = b"x", *, gid: bytes = GID, key: int = KEY, time_ns: int = TIME, size: int = -1
) -> bytes:
    return SAMPLE.pack(DATA, key, len(payload) if size < 0 else size, sequence, time_ns, gid) + payload


class LaneEnd:
    """A reader of a lane with one receiver, and what it leaves to Python. The publisher's last number is 0."""

    def __init__(self, acceptor: object = None) -> None:
        self.track, self.lock = Track(), threading.Lock()
        self.track.sequence = 0
        self.tracks: dict[bytes, Any] = {GID: self.track}
        self.receiver = Receiver(self.tracks, (self.lock.locked,), LIMIT)
        self.acceptor = RecordingAcceptor()
        self.receiver.hand_to(self.acceptor if acceptor is None else acceptor)
        self.receivers: dict[int, Any] = {KEY: self.receiver}
        self.left: list[tuple[int, tuple[int, int, bytes], bytes]] = []
        self.others: list[bytes] = []
        self.files: list[int] = []
        self.on_left: Callable[[], object] = lambda: None
        self.on_other: Callable[[], object] = lambda: None

    def read(self, *records: bytes, room: int = ROOM) -> None:
        """Read the records, and the end of the lane."""
        near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with near, far:
            for record in records:
                near.send(record, socket.MSG_DONTWAIT)
            near.shutdown(socket.SHUT_WR)
            read_lane(far.fileno(), room, self.receivers, self._leave, self._other)

    def _leave(self, number: int, attachment: tuple[int, int, bytes], payload: bytes) -> None:
        self.left.append((number, attachment, payload))
        self.on_left()

    def _other(self, record: bytes, file: int) -> None:
        self.others.append(record)
        self.files.append(file)
        self.on_other()

    def numbers(self) -> list[int]:
        """Return the numbers of the messages that are left to Python."""
        return [attachment[0] for _, attachment, _ in self.left]


@pytest.fixture
def lane() -> LaneEnd:
    return LaneEnd()


def test_the_next_message_of_a_known_publisher_goes_to_the_acceptor(lane: LaneEnd) -> None:
    lane.read(message(1, b"first", time_ns=7), message(2, b"", time_ns=-8))
    assert lane.acceptor.accepted == [(GID, b"first", 7), (GID, b"", -8)]
    assert (lane.track.sequence, lane.track.time_ns, lane.receiver.by_lane) == (2, -8, 2)
    assert lane.left == []


def test_all_messages_of_a_record_are_handed_over_in_order(lane: LaneEnd) -> None:
    lane.tracks[OTHER] = Track()
    lane.tracks[OTHER].sequence = 40
    lane.read(message(1, b"a") + message(41, b"b", gid=OTHER) + message(2, b"c"), message(3, b"d"))
    assert lane.acceptor.accepted == [(GID, b"a", TIME), (OTHER, b"b", TIME), (GID, b"c", TIME), (GID, b"d", TIME)]


def test_an_exit_sends_the_messages() -> None:
    output = RecordingOutput()
    lane = LaneEnd(exit_to(output))
    lane.read(message(1, b"a") + message(2, b"b"), message(4, b"d"))
    assert (output.sent, lane.numbers()) == ([b"a", b"b"], [4])


def test_a_message_that_is_left_to_python_has_all_its_parts(lane: LaneEnd) -> None:
    lane.read(message(-(2**63), b"payload", key=2**32 - 1, gid=bytes(range(16)), time_ns=LAST))
    assert lane.left == [(2**32 - 1, (-(2**63), LAST, bytes(range(16))), b"payload")]


def fails() -> bool:
    raise ZeroDivisionError


OBSTACLES: dict[str, Callable[[LaneEnd], object]] = {
    "unknown publisher": lambda lane: lane.tracks.clear(),
    "state of another type": lambda lane: lane.tracks.update({GID: "state"}),
    "no message before": lambda lane: setattr(lane.track, "sequence", None),
    "gap": lambda lane: setattr(lane.track, "sequence", -1),
    "duplicate": lambda lane: setattr(lane.track, "sequence", 1),
    "older message": lambda lane: setattr(lane.track, "sequence", 9),
    "held message": lambda lane: lane.track.held.update({5: "message"}),
    "lock": lambda lane: lane.lock.acquire(),
    "closed": lambda lane: setattr(lane.receiver, "open", False),
    "no acceptor": lambda lane: lane.receiver.hand_to(None),
    "refused": lambda lane: setattr(lane.acceptor, "accepts", False),
    "no receiver": lambda lane: lane.receivers.clear(),
    "receiver of another type": lambda lane: lane.receivers.update({KEY: "receiver"}),
}


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_message_is_left_to_python_while_something_prevents_it(lane: LaneEnd, name: str) -> None:
    lane.track.time_ns = 2
    OBSTACLES[name](lane)
    before = lane.track.sequence
    lane.read(message(1, b"left"))
    assert lane.left == [(KEY, (1, TIME, GID), b"left")]
    assert (lane.acceptor.accepted, lane.receiver.by_lane) == ([], 0)
    assert (lane.track.sequence, lane.track.time_ns) == (before, 2), "Python finds the state as it was"


@pytest.mark.parametrize("answer", [fails, lambda: True, lambda: 0, lambda: None], ids=["error", "true", "0", "none"])
def test_a_lock_counts_as_held_unless_its_call_returns_false(answer: Callable[[], bool]) -> None:
    lane = LaneEnd()
    locks: tuple[Callable[[], bool], ...] = (lambda: False, answer)
    lane.receivers[KEY] = receiver = Receiver(lane.tracks, locks, LIMIT)
    receiver.hand_to(lane.acceptor)
    lane.read(message(1))
    assert (lane.numbers(), lane.acceptor.accepted) == ([1], [])


def test_a_message_larger_than_the_limit_is_left_to_python(lane: LaneEnd) -> None:
    lane.read(message(1, bytes(LIMIT)), message(2, bytes(LIMIT + 1)))
    assert (len(lane.acceptor.accepted), lane.numbers()) == (1, [2])


def test_the_number_after_the_last_one_does_not_exist(lane: LaneEnd) -> None:
    lane.track.sequence = LAST - 1
    lane.read(message(LAST), message(-LAST - 1))
    assert (len(lane.acceptor.accepted), lane.numbers()) == (1, [-LAST - 1])


def test_the_number_is_counted_before_the_acceptor_runs(lane: LaneEnd) -> None:
    seen: list[tuple[int | None, int]] = []
    lane.acceptor.on_call = lambda: seen.append((lane.track.sequence, lane.track.time_ns))
    lane.read(message(1))
    lane.acceptor.accepts = False
    lane.on_left = lambda: seen.append((lane.track.sequence, lane.track.time_ns))
    lane.read(message(2, time_ns=6))
    assert seen == [(1, TIME), (2, 6), (1, TIME)]


def test_messages_are_plain_again_after_python_has_handled_one(lane: LaneEnd) -> None:
    lane.on_left = lambda: setattr(lane.track, "sequence", 5)
    lane.read(message(5, b"a") + message(6, b"b"), message(7, b"c"))
    assert (lane.numbers(), [payload for _, payload, _ in lane.acceptor.accepted]) == ([5], [b"b", b"c"])


def test_a_receiver_may_change_its_acceptor_while_it_is_called(lane: LaneEnd) -> None:
    lane.acceptor.on_call = lambda: lane.receiver.hand_to(None)
    lane.read(message(1) + message(2))
    assert (len(lane.acceptor.accepted), lane.numbers()) == (1, [2])


def test_random_messages_are_handed_over_once_and_in_order(lane: LaneEnd) -> None:
    draw, sent, seen = random.Random(1), list[tuple[int, bytes]](), list[bytes]()
    lane.acceptor.on_call = lambda: setattr(lane.acceptor, "accepts", draw.random() < 0.7)

    def handle() -> None:
        lane.track.sequence = lane.left[-1][1][0]
        seen.append(lane.left[-1][2])
        lane.acceptor.accepted.append((GID, lane.left[-1][2], TIME))

    lane.on_left = handle
    number = 0
    for _ in range(200):
        record = b""
        for _ in range(draw.randrange(1, 8)):
            number += draw.choice((1, 1, 1, 2))
            sent.append((number, draw.randbytes(draw.randrange(LIMIT + 5))))
            record += message(*sent[-1])
        lane.read(record)
    assert [payload for _, payload, _ in lane.acceptor.accepted] == [payload for _, payload in sent]
    assert (len(seen) > 100, lane.receiver.by_lane) == (True, len(sent) - len(seen))


def test_other_records_go_to_python(lane: LaneEnd) -> None:
    mark = HEAD.pack(MARK, KEY) + b"attachment"
    lane.read(mark, message(1), b"\xff")
    assert (lane.others, len(lane.acceptor.accepted)) == ([mark, b"\xff"], 1)


@pytest.mark.parametrize(
    "end", [message(2)[:-1], message(2, size=2), message(2, size=2**32 - 1), message(2, b"")[:-1], b"\1"]
)
@pytest.mark.parametrize("joined", [True, False])
def test_a_truncated_message_ends_the_reading_after_those_before(lane: LaneEnd, end: bytes, joined: bool) -> None:
    with pytest.raises(ValueError, match="ends within a message"):
        lane.read(*([message(1) + end] if joined else [message(1), end]), message(2))
    assert (len(lane.acceptor.accepted), lane.left) == (1, [])


def test_a_record_that_is_larger_than_the_room_ends_the_reading(lane: LaneEnd) -> None:
    size = len(message(1))
    lane.read(message(1), room=size)
    with pytest.raises(ValueError, match=f"record of {size} bytes"):
        lane.read(message(2, b"xx"), room=size)
    assert len(lane.acceptor.accepted) == 1


def test_errors_of_callbacks_end_the_reading(lane: LaneEnd) -> None:
    lane.on_left = fails
    with pytest.raises(ZeroDivisionError):
        lane.read(message(1) + message(5) + message(2))
    assert (len(lane.acceptor.accepted), lane.numbers()) == (1, [5])
    lane.on_other = fails
    with pytest.raises(ZeroDivisionError):
        lane.read(message(2), HEAD.pack(MARK, KEY), message(3))
    assert lane.track.sequence == 2


def test_errors_of_the_socket_are_raised(lane: LaneEnd) -> None:
    near, far = socket.socketpair()
    with near, far:
        far.setblocking(False)
        with pytest.raises(BlockingIOError):
            read_lane(far.fileno(), ROOM, {}, print, print)
        number = far.fileno()
    with pytest.raises(OSError, match="descriptor"):
        read_lane(number, ROOM, {}, print, print)


def test_an_acceptor_that_is_not_valid_is_refused(lane: LaneEnd) -> None:
    other = RecordingAcceptor()
    other.acceptor = foreign_capsule()
    for owner, error in ((object(), AttributeError), (other, ValueError), (RecordingOutput(), AttributeError)):
        with pytest.raises(error):
            lane.receiver.hand_to(owner)
    lane.read(message(1))
    assert len(lane.acceptor.accepted) == 1, "the earlier acceptor stays"


def test_a_cycle_of_a_receiver_and_its_acceptor_is_collected() -> None:
    lane = LaneEnd()
    lane.acceptor.on_call = lane.read
    acceptor = weakref.ref(lane.acceptor)
    del lane
    gc.collect()
    assert acceptor() is None


def test_a_receiver_releases_its_earlier_acceptor(lane: LaneEnd) -> None:
    earlier = weakref.ref(lane.acceptor)
    lane.acceptor = RecordingAcceptor()
    lane.receiver.hand_to(lane.acceptor)
    gc.collect()
    assert earlier() is None


def test_a_track_has_no_number_before_its_first_message() -> None:
    track = Track()
    assert (track.sequence, track.time_ns, track.held) == (None, 0, {})
    for number in (0, -1, LAST, -LAST - 1):
        track.sequence = number
        assert track.sequence == number
    track.sequence = None
    assert track.sequence is None


@pytest.mark.parametrize(("value", "error"), [("1", TypeError), (1.5, TypeError), (LAST + 1, OverflowError)])
def test_a_track_refuses_other_numbers(value: Any, error: type[Exception]) -> None:
    track = Track()
    track.sequence = 4
    with pytest.raises(error):
        track.sequence = value
    with pytest.raises(AttributeError):
        del track.sequence
    assert track.sequence == 4


def test_the_samples_format_is_the_one_that_c_reads() -> None:
    assert SAMPLE.size == struct.calcsize("<BIIqqB16s") == 42
