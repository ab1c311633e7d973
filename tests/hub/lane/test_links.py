"""Links in C: small messages share a record, and a full socket returns them in order."""

from __future__ import annotations

import gc
import re
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bridge.hub.lane import joining, links, wire
from bridge.hub.lane.joining import MAX_JOINED, MAX_JOINED_BYTES
from bridge.hub.wire.keys import ATTACHMENT_SIZE, GID_SIZE, pack_attachment
from tests.peers.hub.lane import LaneMessage, RecordedLane, lane_messages

GID = bytes(range(100, 116))
TIME = 1_800_000_000_123_456_789
MAX_TOUCHED = 16
"""Maximum number of links on which a thread joins messages."""


@pytest.fixture
def lane() -> Iterator[RecordedLane]:
    lane = RecordedLane()
    yield lane
    lane.close()


@pytest.fixture
def joins() -> Iterator[None]:
    links.join(True)
    yield
    links.join(False)
    links.flush()


def message(number: int, payload: bytes = b"x", key: int = 1) -> LaneMessage:
    return LaneMessage(key, number, TIME + number, GID, payload)


def put(link: links.Link, sent: LaneMessage) -> bytes | None:
    return link.join(sent.key, pack_attachment(sent.number, sent.time_ns, sent.gid), sent.payload)


def fill(lane: RecordedLane, size: int = 1000) -> tuple[int, bytes]:
    """Put messages of ``size`` bytes until the socket is full; return the last number and the record that is left."""
    number, record = 0, None
    while record is None:
        number += 1
        record = put(lane.link, message(number, bytes(size)))
    return number, record


def elsewhere(work: Callable[[], object]) -> None:
    thread = threading.Thread(target=work)
    thread.start()
    thread.join(40)


@pytest.mark.usefixtures("joins")
def test_joined_messages_are_one_record(lane: RecordedLane) -> None:
    payloads = [b"", b"\0\1\0\0", bytes(range(256)) * 16, b"", b"x" * 4095]
    sent = [message(number, payload, key=2**32 - number) for number, payload in enumerate(payloads, 1)]
    assert [put(lane.link, each) for each in sent] == [None] * len(sent)
    assert lane.records() == []
    assert lane.link.flush() is None
    assert lane.records() == [sent]


@pytest.mark.parametrize("number", [0, 1, 2**31, 2**63 - 1, -1])
def test_numbers_and_times_have_64_bits(lane: RecordedLane, number: int) -> None:
    sent = LaneMessage(1, number, -number, GID, b"")
    put(lane.link, sent)
    assert lane.messages() == [sent]


@pytest.mark.usefixtures("joins")
def test_a_record_has_room_for_the_largest_messages(lane: RecordedLane) -> None:
    sent = [message(number, bytes([number]) * MAX_JOINED_BYTES) for number in range(MAX_JOINED)]
    for each in sent:
        put(lane.link, each)
    assert lane.records() == [sent]


def test_a_larger_message_and_another_attachment_are_refused(lane: RecordedLane) -> None:
    attachment = bytes(ATTACHMENT_SIZE)
    with pytest.raises(ValueError, match="too large"):
        lane.link.join(1, attachment, bytes(MAX_JOINED_BYTES + 1))
    for other in (attachment[1:], attachment + b"\0"):
        with pytest.raises(ValueError, match="another size"):
            lane.link.join(1, other, b"x")
    put(lane.link, message(1))
    assert lane.records() == [[message(1)]], "nothing of a refused message is sent"


@pytest.mark.usefixtures("joins")
def test_at_most_max_joined_messages_wait(lane: RecordedLane) -> None:
    sent = [message(number) for number in range(MAX_JOINED + 1)]
    for each in sent[: MAX_JOINED - 1]:
        put(lane.link, each)
    assert lane.records() == []
    put(lane.link, sent[MAX_JOINED - 1])
    assert lane.records() == [sent[:MAX_JOINED]]
    put(lane.link, sent[MAX_JOINED])
    assert lane.records() == []
    links.flush()
    assert lane.records() == [sent[MAX_JOINED:]]


def test_a_thread_that_does_not_join_sends_at_once(lane: RecordedLane) -> None:
    for number in (1, 2):
        put(lane.link, message(number))
        assert lane.records() == [[message(number)]]


@pytest.mark.usefixtures("joins")
def test_a_thread_that_does_not_join_sends_the_messages_of_one_that_does(lane: RecordedLane) -> None:
    put(lane.link, message(1))
    elsewhere(links.flush)
    assert lane.records() == [], "a thread flushes only the links on which it has joined messages"
    elsewhere(lambda: put(lane.link, message(2)))
    assert lane.records() == [[message(1), message(2)]]


@pytest.mark.usefixtures("joins")
def test_a_thread_that_stops_joining_still_flushes(lane: RecordedLane) -> None:
    put(lane.link, message(1))
    links.join(False)
    assert lane.records() == []
    links.flush()
    assert lane.records() == [[message(1)]]


@pytest.mark.usefixtures("joins")
def test_a_thread_joins_messages_on_a_bounded_number_of_links() -> None:
    lanes = [RecordedLane() for _ in range(MAX_TOUCHED + 1)]
    for _ in range(2):
        for lane in lanes:
            put(lane.link, message(1))
        assert [len(lane.records()) for lane in lanes] == [0] * MAX_TOUCHED + [1]
    links.flush()
    assert [lane.records() for lane in lanes[:-1]] == [[[message(1)] * 2]] * MAX_TOUCHED
    for lane in lanes:
        lane.close()


@pytest.mark.usefixtures("joins")
def test_a_full_socket_returns_the_record_and_the_link_is_not_ready(lane: RecordedLane) -> None:
    assert lane.link.ready
    last, record = fill(lane)
    assert not lane.link.ready
    assert [each.number for each in lane.messages() + lane_messages(record)] == list(range(1, last + 1))
    assert lane.link.flush() is None, "the caller has the record"
    assert lane.unsent == []


@pytest.mark.usefixtures("joins")
def test_flush_passes_the_record_of_a_full_socket_to_the_owner(lane: RecordedLane) -> None:
    fill(lane)
    lane.link.ready = True  # as if the owner had sent the record
    put(lane.link, message(1))
    links.flush()
    assert not lane.link.ready
    assert [lane_messages(record) for record in lane.unsent] == [[message(1)]]
    links.flush()
    assert len(lane.unsent) == 1


@pytest.mark.usefixtures("joins")
def test_an_error_of_the_owner_does_not_affect_other_links(lane: RecordedLane, monkeypatch: pytest.MonkeyPatch) -> None:
    errors: list[BaseException | None] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda error: errors.append(error.exc_value))
    failing = links.Link(-1, [].pop)  # raises IndexError
    for link in (lane.link, failing):
        put(link, message(1))
    links.flush()
    assert [type(error) for error in errors] == [IndexError]
    assert lane.records() == [[message(1)]]


@pytest.mark.usefixtures("joins")
def test_closing_a_link_drops_its_messages(lane: RecordedLane) -> None:
    put(lane.link, message(1))
    lane.link.close()
    assert not lane.link.ready
    links.flush()
    assert lane.link.flush() is None
    assert lane.records() == []
    assert lane.unsent == []


def test_a_link_and_its_owner_are_garbage_together() -> None:
    class Owner:
        def __init__(self) -> None:
            self.link = links.Link(-1, self.queue)

        def queue(self) -> None: ...

    owner = weakref.ref(Owner())
    gc.collect()
    assert owner() is None


@pytest.mark.usefixtures("joins")
def test_a_flush_releases_its_links() -> None:
    lane = RecordedLane()
    before = sys.getrefcount(lane.link)
    put(lane.link, message(1))
    joined = sys.getrefcount(lane.link)
    links.flush()
    flushed = sys.getrefcount(lane.link)
    assert (joined, flushed) == (before + 1, before), "the thread refers to the link, which its owner may drop"
    lane.close()


def test_constants_are_those_of_the_modules_in_python() -> None:
    folder = Path(links.__file__).parent
    text = (folder / "links.c").read_text("utf-8") + (folder / "links.h").read_text("utf-8")
    constants = {name: int(value) for name, value in re.findall(r"\b([A-Z_]+) = (\d+)\b", text)}
    expected = {
        "DATA": wire.DATA,
        "SAMPLE": wire.SAMPLE.size,
        "GID": GID_SIZE,
        "ATTACHMENT": ATTACHMENT_SIZE,
        "MAX_JOINED": joining.MAX_JOINED,
        "MAX_JOINED_BYTES": joining.MAX_JOINED_BYTES,
        "MAX_TOUCHED": MAX_TOUCHED,
        "MAX_TARGETS": joining.MAX_LINKS,
    }
    assert {name: constants[name] for name in expected} == expected
    assert MAX_JOINED * (wire.SAMPLE.size + MAX_JOINED_BYTES) <= wire.ROOM, "readers receive at most ROOM bytes"
