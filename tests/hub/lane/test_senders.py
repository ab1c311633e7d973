"""Senders in C: numbers without gaps, silence on zenoh, and messages for a slow reader that stay in order."""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Iterator

import pytest

from bridge.hub.lane import links
from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.joining import MAX_JOINED_BYTES, MAX_LINKS, Joining
from bridge.hub.lane.links import Epoch, Sender
from bridge.hub.lane.outlet import Outlet, ReaderLink
from bridge.hub.wire.keys import pack_attachment
from bridge.routing.counters import CARRY_BOUNDS
from bridge.routing.doorway import Deadline, Doorway
from tests.peers.hub.lane import LaneMessage, RecordedLane

GID = bytes(range(1, 17))


class QueuedLane(RecordedLane):
    """A lane with queues, to which a publisher sends through a doorway, or as `HubPublisher.put` does."""

    def __init__(self) -> None:
        super().__init__()
        self.waits: list[bool] = []
        self.reader_link = ReaderLink(self.near, self.waits.append, Blocks(lambda *_: None), lambda *_: None)
        self.outlet = Outlet(self.reader_link, 1, "0/t/type/hash")
        self.outlet.depth = 100_000
        self.reader_link.outlets[1] = self.outlet
        self.sender = Sender(GID, Epoch())
        self.sender.rest(0, 0)
        self.sender.direct = True
        assert self.reader_link.fast is not None
        self.sender.send_to(((self.reader_link.fast, 1),))
        lease = Deadline()
        lease.until = math.inf
        self.by_python = 0
        self.doorway = Doorway(self.put, lease, None, deque(), None, MAX_JOINED_BYTES, CARRY_BOUNDS)
        self.doorway.admit("a", self.sender)

    def put(self, payload: bytes, _source: str, time_ns: int | None) -> None:
        self.by_python += 1
        self.outlet.send(pack_attachment(self.sender.next(), time_ns or 0, GID), payload)

    def close(self) -> None:
        self.reader_link.close()
        super().close()


@pytest.fixture
def queued() -> Iterator[QueuedLane]:
    lane = QueuedLane()
    yield lane
    lane.close()


def test_a_message_reaches_each_link_under_its_number() -> None:
    lanes = [RecordedLane() for _ in range(MAX_LINKS)]
    sender, lease = Sender(GID, Epoch()), Deadline()
    sender.send_to(tuple((lane.link, 100 + at) for at, lane in enumerate(lanes)))
    sender.rest(0, 0)
    sender.direct, lease.until = True, math.inf
    doorway = Doorway(lambda *_: pytest.fail("it is sent"), lease, None, deque(), None, 100, ())
    doorway.admit("a", sender)
    doorway(b"x", "a", 7)
    assert [lane.records() for lane in lanes] == [[[LaneMessage(100 + at, 1, 7, GID, b"x")]] for at in range(MAX_LINKS)]
    assert (sender.sequence, sender.by_lane) == (1, 1)
    for lane in lanes:
        lane.close()


def test_a_sender_has_a_maximum_number_of_links() -> None:
    sender, link = Sender(GID, Epoch()), links.Link(-1, print)
    sender.send_to(((link, 1),) * MAX_LINKS)
    with pytest.raises(ValueError, match="too many links"):
        sender.send_to(((link, 1),) * (MAX_LINKS + 1))


def test_a_sender_refuses_what_is_not_a_link() -> None:
    with pytest.raises(TypeError):
        Sender(GID, Epoch()).send_to(((object(), 1),))  # type: ignore[arg-type]


@pytest.mark.parametrize("gid", [b"", GID[1:], GID + b"x"])
def test_a_gid_has_16_bytes(gid: bytes) -> None:
    with pytest.raises(ValueError, match="GID"):
        Sender(gid, Epoch())


def test_numbers_have_no_gaps_across_both_ways(queued: QueuedLane) -> None:
    expected = list(range(1, 201))
    for number in expected:
        if number % 3:
            queued.doorway(b"x", "a", number)
        else:
            queued.put(b"x", "a", number)
    assert queued.by_python == 66
    assert [(message.number, message.time_ns) for message in queued.messages()] == [(n, n) for n in expected]
    assert queued.sender.next() == 201


def test_numbers_continue_after_one_that_was_set(queued: QueuedLane) -> None:
    queued.sender.sequence = 2**40
    queued.doorway(b"x", "a", 0)
    assert [message.number for message in queued.messages()] == [2**40 + 1]


def test_a_sender_is_quiet_only_in_the_epoch_and_with_the_matches_of_its_rest() -> None:
    epoch = Epoch()
    sender = Sender(GID, epoch)
    assert not sender.is_quiet(), "a new publisher does not know its subscribers"
    sender.rest(epoch.value, sender.matches)
    assert sender.is_quiet()
    epoch.renew()
    assert not sender.is_quiet()
    sender.rest(epoch.value, sender.matches)
    assert sender.is_quiet()
    sender.match()
    assert not sender.is_quiet()
    sender.rest(epoch.value, sender.matches - 1)
    assert not sender.is_quiet(), "a subscriber has appeared during the query"
    sender.rest(epoch.value - 1, sender.matches)
    assert not sender.is_quiet(), "the graph has changed during the query"
    sender.rest(epoch.value, sender.matches)
    assert sender.is_quiet()


def test_senders_share_an_epoch_but_not_their_matches() -> None:
    epoch = Epoch()
    first, second = Sender(GID, epoch), Sender(GID, epoch)
    for sender in (first, second):
        sender.rest(0, 0)
    first.match()
    assert (first.is_quiet(), second.is_quiet()) == (False, True)
    epoch.renew()
    assert not second.is_quiet()
    assert epoch.value == 1


def test_messages_for_a_full_reader_wait_in_order(queued: QueuedLane) -> None:
    sent = 0
    while not queued.outlet.queue:
        sent += 1
        queued.doorway(bytes(1000), "a", 0)
    assert queued.by_python == 0, "the doorway has sent until the socket was full"
    assert queued.reader_link.fast is not None
    assert not queued.reader_link.fast.ready
    queued.doorway(b"x", "a", 0)
    assert queued.by_python == 1
    numbers = [message.number for message in queued.messages()]
    queued.reader_link.flush()
    assert queued.reader_link.fast.ready
    assert numbers + [message.number for message in queued.messages()] == list(range(1, sent + 2))
    queued.doorway(b"x", "a", 0)
    assert queued.by_python == 1, "the doorway sends again"


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_lost_or_reordered_for_a_slow_reader(queued: QueuedLane, seed: int) -> None:
    draw, joining = random.Random(seed), Joining()
    sent: list[tuple[int, bytes]] = []
    received: list[LaneMessage] = []

    def catch_up() -> None:
        received.extend(queued.messages())
        while queued.outlet.queue:
            queued.reader_link.flush()
            received.extend(queued.messages())

    for _ in range(2000):
        step = draw.random()
        if step < 0.94:
            payload = draw.randbytes(draw.choice((0, 1, 100, MAX_JOINED_BYTES, MAX_JOINED_BYTES + 1)))
            draw.choice((queued.doorway, queued.put))(payload, "a", 0)
            sent.append((queued.sender.sequence, payload))
        elif step < 0.98:
            joining.flush()
        elif step < 0.985:
            queued.reader_link.flush()
        elif step < 0.99:
            received += queued.messages()
        else:
            catch_up()
    joining.end()
    catch_up()
    assert [number for number, _ in sent] == list(range(1, len(sent) + 1))
    assert [(message.number, message.payload) for message in received] == sent
    assert queued.doorway.messages > 100, "both ways were used"
    assert queued.by_python > 100
    assert queued.waits.count(True) >= 3, "the socket was full"
