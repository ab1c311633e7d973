"""The parts of a subscription: the states of publishers, the losses, and the decoder of samples."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from bridge.hub.endpoints import subscription
from bridge.hub.endpoints.subscription import OVERHEAD, HubSample, Losses, PublisherState, PublisherStates, SampleReader
from bridge.hub.wire.keys import pack_attachment

GID = b"g" * 16


def message(sequence: int, time_ns: int = 0, gid: bytes = GID, size: int = 1) -> HubSample:
    return HubSample(zenoh.ZBytes(bytes(size)), sequence, time_ns or sequence, gid, "z")


@pytest.mark.parametrize(
    ("numbers", "gaps"),
    [
        ([1, 2, 3], [0, 0, 0]),
        ([5, 6], [0, 0]),
        ([1, 4, 5], [0, 2, 0]),
        ([1, 2, 2, 1, 3], [0, 0, None, None, 0]),
        ([1, 2_000_000], [0, 0]),
    ],
)
def test_gaps_and_duplicates_are_detected_by_number(numbers: list[int], gaps: list[int | None]) -> None:
    state = PublisherState("z")
    assert [state.accept(message(number)) for number in numbers] == gaps


def test_restarted_numbers_are_accepted_if_the_sample_is_newer() -> None:
    state = PublisherState("z")
    assert [state.accept(message(n, t)) for n, t in ((7, 700), (1, 800), (2, 750), (1, 600))] == [0, 0, 0, None]


class Graph:
    """The zenoh session IDs of publishers, by GID."""

    def __init__(self) -> None:
        self.zids: dict[bytes, str] = {}

    def zid_of(self, gid: bytes) -> str:
        return self.zids.get(gid, "")


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def states(graph: Graph) -> PublisherStates:
    return PublisherStates(cast("Any", graph))


def sample(zid: str = "") -> Any:
    return SimpleNamespace(source_info=SimpleNamespace(source_id=SimpleNamespace(zid=zid)) if zid else None)


def test_session_comes_from_the_sample_or_else_from_the_graph(graph: Graph, states: PublisherStates) -> None:
    unknown = message(1)
    assert (states.of(unknown, sample()).zid, unknown.zid) == ("", "")
    graph.zids[GID] = "from the graph"
    known = message(2)
    assert states.of(known, sample()) is states[GID]
    assert known.zid == "from the graph"
    other = message(1, gid=b"o" * 16)
    assert states.of(other, sample("in the sample")).zid == other.zid == "in the sample"


def test_departed_publishers_are_dropped_except_the_newest(graph: Graph, states: PublisherStates) -> None:
    present = [b"present %d" % number for number in range(10)]
    graph.zids.update(dict.fromkeys(present, "z"))
    for gid in present:
        states.add(gid)
    states.hold(states.add(b"holds"), message(1))
    for number in range(1000):
        states.add(b"departed %d" % number)
    assert len(states) < 300
    assert {*present, b"holds", b"departed 999"} <= states.keys()
    assert b"departed 0" not in states


def test_number_of_publishers_is_limited_though_all_are_present(
    graph: Graph, states: PublisherStates, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscription, "_MAX_SOURCES", 200)
    for number in range(500):
        gid = b"%d" % number
        graph.zids[gid] = "z"
        states.hold(states.add(gid), message(1))
    assert len(states) == 200
    assert states.held_bytes == 200 * (1 + OVERHEAD)


def test_held_samples_are_returned_in_order_and_counted_in_bytes(
    states: PublisherStates, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscription, "MAX_HELD_BYTES", 3 * (10 + OVERHEAD))
    source = states.add(GID)
    assert [states.hold(source, message(number, size=10)) for number in (3, 1, 2, 4, 1)] == [
        True, True, True, False, True
    ]  # fmt: skip
    assert states.held_bytes == 3 * (10 + OVERHEAD)
    states.hold_anyway(source, message(9, size=5))
    assert states.pop_held(source, 3).sequence == 3
    assert [held.sequence for held in states.pop_all_held(source)] == [1, 2, 9]
    assert (states.held_bytes, source.held) == (0, {})


def test_losses_name_the_newest_sources() -> None:
    losses = Losses()
    for number in range(100):
        losses.add(2, message(1, gid=b"%d" % number))
    losses.add(1, message(5, gid=b"99"))
    assert losses.count == 201
    assert losses.sources()[b"99", "z"] == 3
    assert len(losses.sources()) == subscription._SPARED


def received(payload: bytes = b"x", attached: bytes | None = b"", kind: object = zenoh.SampleKind.PUT) -> Any:
    attachment = None if attached is None else SimpleNamespace(to_bytes=lambda: attached)
    encoding = zenoh.Encoding.ZENOH_BYTES
    return SimpleNamespace(payload=zenoh.ZBytes(payload), attachment=attachment, kind=kind, encoding=encoding)


VALID = pack_attachment(4, 1000, GID)


def test_reader_returns_valid_samples_of_other_nodes() -> None:
    own = {b"o" * 16}
    reader = SampleReader("/t", own, 10, None)
    read = reader.read(received(attached=VALID))
    assert read is not None
    assert (read.sequence, read.source_time_ns, read.gid, read.zid, read.data()) == (4, 1000, GID, "", b"x")
    assert reader.read(received(attached=pack_attachment(4, 1000, b"o" * 16))) is None
    assert reader.read(received(b"", attached=None, kind=zenoh.SampleKind.DELETE)) is None
    assert reader.refused == 0


@pytest.mark.parametrize(
    ("sample", "reason", "why"),
    [
        (received(attached=None), "bad", "a sample without rmw_zenoh's attachment"),
        (received(attached=b"short"), "bad", ""),
        (received(bytes(11), VALID), "large", "message of 11 bytes, the limit is 10"),
    ],
)
def test_refused_sample_is_counted_and_reported(
    sample: Any, reason: str, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    reports: list[tuple[str, str]] = []
    silent, reporting = SampleReader("/t", (), 10, None), SampleReader("/t", (), 10, lambda *why: reports.append(why))
    for reader in (silent, silent, reporting):
        assert reader.read(sample) is None
    assert (silent.refused, reporting.refused) == (2, 1)
    assert reports[0][0] == reason
    assert why in reports[0][1]
    levels = [record.levelno for record in caplog.records if record.name == subscription.__name__]
    assert levels == [logging.WARNING, logging.DEBUG, logging.DEBUG]


def test_closed_reader_reads_nothing() -> None:
    reader = SampleReader("/t", (), 10, None)
    assert [reader.close(), reader.close()] == [True, False]
    assert reader.read(received(attached=VALID)) is None
    assert reader.read(received(attached=None)) is None
    assert reader.refused == 0
